/** The columns that lists of episodes can show and sort by. */
import type { Episode } from "./episodes";
import { dateTime, number, percent, words } from "./format";

export interface Column {
  /** Its name in `listed`, and in addresses. */
  key: string;
  title: string;
  number?: boolean;
  /** Whether it is there before anybody chooses. */
  usual?: boolean;
  show(row: Episode): string;
}

const text = (key: string) => (row: Episode) => (row[key] === null || row[key] === undefined ? "–" : String(row[key]));
const plain = (key: string) => (row: Episode) => words(row[key] as string | null);
const digits = (key: string, many = 0) => (row: Episode) => number(row[key] as number | null, many);

export const COLUMNS: Column[] = [
  { key: "outcome", title: "Outcome", usual: true, show: text("outcome") },
  { key: "task_id", title: "Task", usual: true, show: text("task_id") },
  { key: "policy", title: "Policy", usual: true, show: text("policy") },
  { key: "class", title: "Class", usual: true, show: text("class") },
  { key: "sub_class", title: "Sub-class", usual: true, show: plain("sub_class") },
  { key: "decisive_step", title: "Decisive step", number: true, usual: true, show: digits("decisive_step") },
  { key: "length", title: "Steps", number: true, usual: true, show: digits("length") },
  { key: "completion", title: "CR", number: true, usual: true, show: (row) => percent(row["completion"] as number | null) },
  { key: "total_reward", title: "Return", number: true, usual: true, show: digits("total_reward", 2) },
  { key: "verdict", title: "Replay", usual: true, show: plain("verdict") },
  { key: "label", title: "Label", show: plain("label") },
  { key: "labelled_by", title: "Labelled by", show: text("labelled_by") },
  { key: "starred_by", title: "★ Starred by", show: text("starred_by") },
  { key: "tags", title: "Tags", show: text("tags") },
  { key: "comments", title: "Comments", number: true, show: digits("comments") },
  { key: "trace_modified_ns", title: "Recorded", show: (row) => dateTime(Number(row["trace_modified_ns"]) / 1e6) },
  { key: "family", title: "Family", show: text("family") },
  { key: "run_id", title: "Run", show: text("run_id") },
  { key: "seed", title: "Seed", number: true, show: text("seed") },
  { key: "instruction", title: "Instruction", show: text("instruction") },
  { key: "target_category", title: "Target", show: text("target_category") },
  { key: "src", title: "Source", show: text("src") },
  { key: "dest", title: "Destination", show: text("dest") },
  { key: "cause", title: "Cause", show: plain("cause") },
  { key: "wasted_steps", title: "Wasted steps", number: true, show: digits("wasted_steps") },
  { key: "point_of_no_return", title: "Point of no return", number: true, show: digits("point_of_no_return") },
  { key: "asks", title: "Asks", number: true, show: digits("asks") },
  { key: "spl", title: "SPL", number: true, show: digits("spl", 2) },
  { key: "discounted_return", title: "Discounted return", number: true, show: digits("discounted_return", 2) },
  { key: "path_length_m", title: "Path, m", number: true, show: digits("path_length_m", 1) },
  { key: "end_reason", title: "End", show: plain("end_reason") },
  { key: "checkpoint", title: "Checkpoint", show: text("checkpoint") },
  { key: "group_id", title: "Group", show: text("group_id") },
  { key: "profile", title: "Profile", show: text("profile") },
  { key: "preset", title: "Reward preset", show: text("preset") },
  { key: "episode_id", title: "Id", show: text("episode_id") },
];

export const USUAL = COLUMNS.filter((column) => column.usual).map((column) => column.key);

/** The columns of an address (`columns=a,b`), in our order. */
export function columnsOf(chosen: string | null): Column[] {
  const keys = chosen === null ? USUAL : chosen.split(",");
  return COLUMNS.filter((column) => keys.includes(column.key));
}

/** What a list needs of every row, whatever it shows. */
const ALWAYS = ["episode_id", "trace", "outcome", "policy", "family", "task_id", "class", "sub_class", "decisive_step", "trace_digest", "parent_trace", "parent_call"];

/** What is read of every row, `more` besides. */
export function selected(columns: Column[], more: string[] = []): string {
  return [...new Set([...ALWAYS, ...columns.map((column) => column.key), ...more])].join(", ");
}

/** An order by a column of ours; what is not there comes last, and equal rows keep their place. */
export function order(sort: string | null, descending: boolean): string {
  const key = COLUMNS.find((column) => column.key === sort)?.key ?? "trace_modified_ns";
  return `${key} ${descending ? "DESC" : "ASC"} NULLS LAST, episode_id`;
}
