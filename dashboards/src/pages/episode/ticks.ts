/** What the clock shows at each of its moments. */
import { callText, rewardOf, type Step } from "../../lib/trace";
import { callAt, differs } from "./alignment";
import type { Pair } from "./beside.svelte";

export interface Tick {
  /** The calls, for the tooltip and for screen readers. */
  text: string;
  reward: number;
  error: boolean;
  /** Whether the calls of a row differ, or what came of them. */
  differs: boolean;
}

export function ticksOf(steps: Step[]): Tick[] {
  return steps.map((step) => ({
    text: callText(step.input.call), reward: rewardOf(step), error: Boolean(step.outcome.error), differs: false,
  }));
}

/** The rows of two episodes, with the rewards of the first one. */
export function pairTicks({ own, other, alignment, names }: Pair): Tick[] {
  return alignment.rows.map((row) => {
    const step = row.a === null ? undefined : own.steps[row.a];
    const beside = row.b === null ? undefined : other.steps[row.b];
    return {
      text: `${names[0]}: ${callAt(own, row.a)}; ${names[1]}: ${callAt(other, row.b)}`, reward: step ? rewardOf(step) : 0,
      error: Boolean(step?.outcome.error ?? beside?.outcome.error), differs: differs(row),
    };
  });
}
