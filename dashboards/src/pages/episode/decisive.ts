/** Who determined the decisive step of an episode, and why it is this one. */
import type { Blame } from "../../lib/trace";

/** The rule that classified the episode, from table `classes`: its evidence and the step that it takes for decisive. */
export interface RuleEvidence {
  rule: string;
  step: number;
  last_step: number;
}

function measured({ decisive, costs }: Blame): string {
  if (!decisive) return "";
  const { step, harm } = decisive;
  if (harm === "world") return "It is the first change of the world that left more to do and was never made good.";
  if (harm === "ending") return "It ended the episode while success was still possible.";
  const before = costs.filter((cost) => cost.step < step && cost.regret).map((cost) => cost.step);
  const earlier = !before.length ? "No call before it lost any."
    : `What ${before.length === 1 ? `step ${before[0]}` : `steps ${before.join(", ")}`} lost before was made good or could be afforded.`;
  return `The calls from here to the end lost the most time. ${earlier}`;
}

function ruled({ rule, step, last_step }: RuleEvidence, decisive: number): string {
  const evidence = step === last_step ? `step ${step}` : `steps ${step} to ${last_step}`;
  const within = decisive >= step && decisive <= last_step;
  return `The evidence of rule ${rule} is ${evidence}${within ? "" : ", without this one"}.`;
}

/** In sentences, why the step is decisive; empty if neither blame nor a rule says one. */
export function whyDecisive(blame: Blame | null, found: RuleEvidence | undefined): string {
  if (blame?.decisive) {
    return `Measured by reel blame. ${measured(blame)}${found ? ` ${ruled(found, blame.decisive.step)}` : ""}`;
  }
  return found ? `Determined by rule ${found.rule}: its evidence begins here.` : "";
}
