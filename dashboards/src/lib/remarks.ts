/** Remarks on episodes (stars, tags, comments): how they are read, stored, taken back, and shown in lists. */
import { get, post, remove, sql } from "./api";
import { author } from "./labels";
import { link } from "./route.svelte";

/** A row of table `remarks`. */
export interface Remark {
  episode_id: string;
  author: string;
  kind: "star" | "tag" | "comment";
  /** The words of a tag or comment; a star has none, and the text is empty. */
  text: string;
  /** The step that it is about; null: the whole episode. */
  step: number | null;
  at_ms: number;
}

/** Everything but the time, by which the service knows one remark from another. */
export type RemarkKey = Omit<Remark, "at_ms">;

export const TAG_LETTERS = 60;
export const COMMENT_LETTERS = 4000;

/** What a list shows of the remarks of each episode, for a join. A comma in a name would make two people of it. */
export const REMARKED = `SELECT episode_id,
      string_agg(DISTINCT said, ', ' ORDER BY said) FILTER (WHERE kind = 'star') AS starred_by,
      string_agg(DISTINCT said, ', ' ORDER BY said) FILTER (WHERE kind = 'tag') AS tags,
      nullif(count(*) FILTER (WHERE kind = 'comment'), 0) AS comments
    FROM (
      SELECT episode_id, kind, CASE kind WHEN 'star' THEN replace(author, ', ', ' ') ELSE text END AS said FROM remarks
    ) GROUP BY episode_id`;

/** The name of somebody who starred, as lists have it. */
export const starName = (author: string) => author.replaceAll(", ", " ");

/** Remarks on an episode by all authors, in the order of time. */
export async function remarksOf(episode: string, signal?: AbortSignal): Promise<Remark[]> {
  return (await get(`/api/remarks?episode=${encodeURIComponent(episode)}`, signal)) as unknown as Remark[];
}

/** The tags of all episodes; the most frequent come first. */
export async function usedTags(signal?: AbortSignal): Promise<string[]> {
  const rows = await sql<{ text: string }>(
    "SELECT text FROM remarks WHERE kind = 'tag' GROUP BY text ORDER BY count(*) DESC, text LIMIT 200", {}, signal,
  );
  return rows.map(({ text }) => text);
}

/** Stores a remark, and remembers its author: with tokens, the service says who that is. */
export async function putRemark({ episode_id, author: by, kind, text, step }: RemarkKey): Promise<void> {
  const body = { episode: episode_id, author: by, kind, text, step };
  const stored = (await post("/api/remarks", body)) as unknown as { author?: string };
  author.set(stored.author ?? by);
}

function dropRemark({ episode_id, author, kind, text, step }: RemarkKey): Promise<void> {
  return remove(link(`/api/remarks/${encodeURIComponent(episode_id)}`, { author, kind, text, step }));
}

/** A change of remarks: what it does, in words, and what is there afterwards that was not, and the other way round. */
export interface Change {
  done: string;
  adds: RemarkKey[];
  drops: RemarkKey[];
}

export function adding(remark: RemarkKey): Change {
  const done = { star: "Starred.", tag: `Tagged “${remark.text}”.`, comment: "Comment stored." }[remark.kind];
  return { done, adds: [remark], drops: [] };
}
export function taking(remark: RemarkKey): Change {
  const done = { star: "Star removed.", tag: `Tag “${remark.text}” removed.`, comment: "Comment deleted." }[remark.kind];
  return { done, adds: [], drops: [remark] };
}
export function rewording(remark: RemarkKey, text: string): Change {
  return { done: "Comment changed.", adds: [{ ...remark, text }], drops: [remark] };
}
/** What takes a change back. */
export const opposite = ({ done, adds, drops }: Change): Change => ({ done, adds: drops, drops: adds });

/** Stores a change: what is new comes first, so that a failure loses nothing. */
export async function storeChange({ adds, drops }: Change): Promise<void> {
  for (const remark of adds) await putRemark(remark);
  for (const remark of drops) await dropRemark(remark);
}

const same = (a: RemarkKey, b: RemarkKey) =>
  a.kind === b.kind && a.author === b.author && a.text === b.text && a.step === b.step && a.episode_id === b.episode_id;

/** The remarks as they are after a change. */
export function changed(remarks: Remark[], { adds, drops }: Change, at_ms: number): Remark[] {
  const kept = remarks.filter((remark) => !drops.some((drop) => same(drop, remark)));
  return [...kept, ...adds.filter((add) => !kept.some((remark) => same(add, remark))).map((add) => ({ ...add, at_ms }))];
}

/** What is wrong with a tag; empty if nothing is. */
export function tagError(text: string): string {
  if (text.includes(",")) return "A tag has no comma: add one tag after the other.";
  if (text === "none") return "Lists call episodes without a tag “none”: take another word.";
  return text.length > TAG_LETTERS ? `A tag has at most ${TAG_LETTERS} letters.` : "";
}
