/** What a job is called, and what is said of its end. */
import type { Job, Work } from "./generated";

const EXIT = "the command exited with";

export function jobTitle(work: Work): string {
  switch (work.kind) {
    case "ingest": return `Ingest of ${traces(work.traces)}`;
    case "replay": return `Replay of ${traces(work.traces)}`;
    case "blame": return "Blame of all failed episodes";
    case "taxonomy": return "Taxonomy of all failed episodes";
    case "attribute": return "Attribution of all failed episodes";
    case "counterfactuals": return `Plausible calls of ${traces(work.traces)}`;
    case "reward": return `Reward preset ${work.preset}`;
    case "export": return `Export ${work.name} (${work.set})`;
  }
}

function traces(names: string[] | undefined): string {
  if (!names?.length) return "all traces";
  return names.length === 1 ? names[0]! : `${names.length} traces`;
}

/** What the job complained of, without the program's name and its exit status. */
export function complaints(job: Job): string[] {
  return job.errors.filter((line) => !line.startsWith(EXIT)).map((line) => line.replace(/^reel: /, ""));
}

/** Why a job failed, in one sentence: the error that the command printed, else what its report says. */
export function failure(job: Job): string {
  const said = job.errors.find((line) => line.startsWith("reel: "))?.slice(6) ?? complaints(job)[0];
  if (said) return sentence(said);
  const replayed = job.report.filter((line): line is { verdict: string } => typeof line === "object" && line !== null && "verdict" in line);
  const other = replayed.filter(({ verdict }) => verdict !== "exact").length;
  if (other) return `${other} of ${replayed.length} traces did not replay exactly.`;
  return sentence(job.errors.at(-1) ?? "The command printed no error");
}

function sentence(text: string): string {
  const short = text.length > 240 ? `${text.slice(0, 240).trimEnd()} …` : text;
  return /[.!?…]$/.test(short) ? short : `${short}.`;
}
