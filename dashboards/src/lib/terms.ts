/** What the words of the tables mean: the words of docs/spec.md, docs/blame.md and docs/taxonomy.md, in a sentence each. */
import { words } from "./format";
import { CLASSES } from "./taxonomy";

export type Terms = Readonly<Record<string, string>>;

export const FAMILIES: Terms = {
  FDP: "Pick and place among similar furniture; the instruction is precise.",
  FODP: "Pick and place among similar furniture and similar objects; the instruction is precise.",
  FDO: "Furniture has doors that must be opened, and closed again.",
  SUL: "The instruction leaves open which object is meant: the agent has to ask.",
  other: "A task outside REAL-Bench.",
};
export const METRICS: Terms = {
  SR: "Success rate: the share of the episodes that reach the whole goal.",
  CR: "Completion rate: the share of the goal's changes that hold at the end.",
  SPL: "Success weighted by path length: 1 is a success by the shortest way, 0 a failure.",
};

const CLASS: Terms = {
  "Object Confusion": "The agent handled the wrong object or used the wrong place.",
  "Key Action Missing": "The agent never made an action that the task cannot do without.",
  "Lost Memory": "The agent lost track of what it had done or seen.",
  Other: "None of the three other classes explains the failure.",
  "not classified": "No rule has seen this failure yet: reel taxonomy classifies it.",
};
const SUB_CLASS: Terms = {
  wrong_instance: "Took another copy of exactly the target.",
  wrong_kind: "Took an object of another category than the target.",
  wrong_attribute: "Took an object of the target's category with another colour, shape or size.",
  wrong_receptacle: "Put the target on furniture that is not like the destination.",
  similar_furniture: "Put the target on furniture of the destination's category, or like it.",
  ignored_answer: "Asked, was told which object is meant, and took another one.",
  missing_ask: "The instruction fits several objects; the agent did not ask and took a wrong one.",
  missing_open: "Never opened a door that had to be opened.",
  missing_pick: "Found where the target stands, did not pick it, and went on as if it held it.",
  missing_place: "Carried the target to its destination and finished without placing it.",
  never_looked: "Picked nothing and never looked where the target stands.",
  premature_finish: "Called finish in the middle of the work.",
  uninformative_ask: "Asked, but the answer did not tell the target from other objects, and took a wrong one.",
  incomplete: "Did some of several objects and finished without the others.",
  oscillation: "Went around among the same places up to the end and learned nothing new.",
  exploration: "Spent the decisions on looking around at new places.",
  repeated_failure: "Made calls again that had failed in the same state of the world.",
  stale_marker: "Used a marker number that is not on the current map, and did not find back.",
  false_history: "Its History claims a success that the record does not hold.",
  repeated_call: "Made the same calls again up to the end, which could bring nothing new.",
  repeated_question: "Asked again what the user had answered.",
  door_closed_again: "Opened a door and closed it before it had reached what is behind it.",
  undone_success: "Took an object away again from where the goal wants it.",
  timeout: "The decisions ran out, and no other rule says on what.",
  invalid_output: "Up to the end, most output was no valid call: no call at all, an unknown tool or bad arguments.",
  physical_failure: "The target fell to the floor, or the physics broke down.",
  primitive_failure: "A skill of the robot, or what executes its calls, failed.",
  unexplained: "No other rule explains the failure.",
};
const CAUSE: Terms = {
  perception: "The agent took or used a wrong candidate although its look, or the name of its place, told it apart.",
  communication: "The agent took one of several that fitted, and no answer had told them apart.",
  memory: "The agent went where it had been in vain, looked where all was known, or repeated what had just failed.",
  primitive: "A skill of the robot failed, or what executes its calls.",
  other: "The agent left out something that was due, or its output was no valid call.",
};
const END: Terms = {
  finished: "The agent called finish.",
  horizon: "The agent used up its decisions (30 in the paper).",
  fault: "An error that cannot be recovered from ended the episode.",
  aborted: "The client ended the episode before the agent did.",
};
const OUTCOME: Terms = {
  success: "The whole goal holds at the end.",
  failure: "The episode ended, and a part of the goal does not hold.",
  "broken off": "The recording stops before the episode ended.",
  "not judged": "The task has no goal that Reel knows, and nobody said whether it was reached.",
};
export const VERDICTS: Terms = {
  exact: "replayed, every digest equal",
  exact_without_rgb: "replayed for rows without images",
  diverged: "a replay came to something else",
  unverified: "not replayed yet",
};
/** Columns of lists of episodes, which facets share. */
const COLUMN: Terms = {
  outcome: "Whether the whole goal holds at the end.",
  family: "The kind of task.",
  class: "What kind of mistake explains the failure, by the rules of reel taxonomy.",
  sub_class: "Which rule within the class explains the failure.",
  cause: "What the decisive mistake was a matter of, measured by reel blame.",
  decisive_step: "The call that decided the failure.",
  length: "Decisions of the agent.",
  completion: METRICS["CR"]!,
  spl: METRICS["SPL"]!,
  total_reward: "The sum of the rewards.",
  discounted_return: "The sum of the rewards, each later one discounted by 0.99.",
  verdict: "Whether a replay came to the same digests.",
  end_reason: "How the episode ended.",
  label: "The class that people gave.",
  wasted_steps: "Steps lost: the sum of the regret of all calls. A call's regret is how far the cost to go did not fall by one, so it can be more than one.",
  point_of_no_return: "The step from which the decisions left were too few to be sure of success.",
  asks: "Questions to the user.",
  run_id: "The episodes of one command.",
};

const VALUES: Terms = Object.assign({}, FAMILIES, METRICS, CLASS, SUB_CLASS, CAUSE, END, OUTCOME, VERDICTS);

/** What a value of the tables means, for a tooltip; undefined if it is no term. */
export const termTitle = (value: unknown): string | undefined => VALUES[String(value)];
/** What a column of lists of episodes says, for a tooltip. */
export const columnTitle = (key: string): string | undefined => COLUMN[key];

/** Terms of one kind, for `components/Terms.svelte`. */
export interface TermGroup {
  title: string;
  about?: string;
  terms: Terms;
}
export const BENCHMARK_TERMS: TermGroup[] = [{ title: "Families", terms: FAMILIES }, { title: "Metrics", terms: METRICS }];
const inWords = (terms: Terms): Terms => Object.fromEntries(Object.entries(terms).map(([name, meaning]) => [words(name), meaning]));
export const FAILURE_TERMS: TermGroup[] = [
  ...Object.entries(CLASSES).map(([name, subClasses]) => (
    { title: name, about: CLASS[name], terms: inWords(Object.fromEntries(subClasses.map((one) => [one, SUB_CLASS[one] ?? ""]))) })),
  { title: "Cause", about: COLUMN["cause"], terms: CAUSE },
];
export const EPISODE_TERMS: TermGroup[] = [
  { title: "Outcome", terms: OUTCOME }, { title: "End", about: COLUMN["end_reason"], terms: END }, { title: "Replay", about: COLUMN["verdict"], terms: inWords(VERDICTS) },
  ...BENCHMARK_TERMS, ...FAILURE_TERMS,
];
