/** Changes of remarks that were made on a page that was left at once: the next page tells whether they were stored. */

export type Fate = "storing" | "stored" | "refused";

export class EarlierChange {
  fate = $state<Fate>("storing");
  /** Why it was refused. */
  problem = $state("");
  private ended_ms = 0;

  constructor(readonly trace: string, readonly done: string) {}

  end(problem = "") {
    this.problem = problem;
    this.fate = problem ? "refused" : "stored";
    this.ended_ms = Date.now();
    if (changes.includes(this)) this.forgetSoon();
  }
  /** Whether whoever leaves the page now may not have seen how it ended. */
  get unseen(): boolean {
    return this.fate === "storing" || Date.now() - this.ended_ms < TOLD_MS;
  }
  /** What was stored is told for a moment; what was refused stays until somebody has seen it. */
  forgetSoon() {
    if (this.fate === "stored") setTimeout(() => forget(this), TOLD_MS);
  }
}

const TOLD_MS = 6000;
let changes = $state.raw<EarlierChange[]>([]);

export const earlier = {
  get all(): EarlierChange[] { return changes; },
};

/** Takes over what was changed on a page that is left. */
export function takeOver(left: EarlierChange[]) {
  const unseen = left.filter((change) => change.unseen);
  changes = [...changes, ...unseen];
  for (const change of unseen) change.forgetSoon();
}

export function forget(change: EarlierChange) {
  changes = changes.filter((one) => one !== change);
}
