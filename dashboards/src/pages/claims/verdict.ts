/** What a verdict is called on the page. */
import { type Claim, type Tally, type ClaimReport, counted, promise } from "../../lib/claims";

const NAMES = { holds: "holds", open: "cannot tell yet", fails: "fails" };

export function verdictName(verdict: Tally["verdict"]): string {
  return verdict ? NAMES[verdict] : "no verdict";
}

/** The verdict with its numbers: `holds: 23 of 41 (56%, 95% interval 41 to 70%), promised at least 50%`. */
export function verdictSentence(count: Tally, claim: Claim): string {
  const promised = promise(claim);
  if (!count.episodes) return `No episode is counted${promised ? `; promised ${promised}` : ""}.`;
  if (!promised) return `${counted(count)}; nothing is promised, so there is no verdict.`;
  return `${verdictName(count.verdict)}: ${counted(count)}, promised ${promised}`;
}

/** Since which run the verdict is what it is in the newest one that has one; empty if it was never another. */
export function changeSentence({ runs, changed }: ClaimReport): string {
  const newest = runs.findLast(({ verdict }) => verdict === "holds" || verdict === "fails");
  if (!newest || !changed) return "";
  return `Run by run: ${verdictName(newest.verdict)} since ${runName(changed.run_id)}; before: ${verdictName(changed.before)}.`;
}

export function runName(id: string | null): string {
  return id === null ? "episodes without a run" : `run ${id}`;
}
