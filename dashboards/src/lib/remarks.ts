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
export async function putRemark({ episode_id, author: by, kind, text, step }: RemarkKey): Promise<RemarkKey> {
  const body = { episode: episode_id, author: by, kind, text, step };
  const stored = (await post("/api/remarks", body)) as unknown as { author?: string };
  const own = { episode_id, author: stored.author ?? by, kind, text, step };
  author.set(own.author);
  return own;
}

export function dropRemark({ episode_id, author, kind, text, step }: RemarkKey): Promise<void> {
  return remove(link(`/api/remarks/${encodeURIComponent(episode_id)}`, { author, kind, text, step }));
}

/** A change that was stored: what was done, in words, and how it is taken back. */
export interface Change {
  done: string;
  undo: () => Promise<unknown>;
}

export async function add(remark: RemarkKey): Promise<Change> {
  const stored = await putRemark(remark);
  const done = { star: "Starred.", tag: `Tagged “${remark.text}”.`, comment: "Comment stored." }[remark.kind];
  return { done, undo: () => dropRemark(stored) };
}

export async function take(remark: RemarkKey): Promise<Change> {
  await dropRemark(remark);
  const done = { star: "Star removed.", tag: `Tag “${remark.text}” removed.`, comment: "Comment deleted." }[remark.kind];
  return { done, undo: () => putRemark(remark) };
}

/** Another text for a remark. The new one is stored first, so that a failure loses nothing. */
export async function edit(remark: RemarkKey, text: string): Promise<Change> {
  const changed = await putRemark({ ...remark, text });
  await dropRemark(remark);
  return {
    done: "Comment changed.",
    undo: async () => {
      await putRemark(remark);
      await dropRemark(changed);
    },
  };
}

/** What is wrong with a tag; empty if nothing is. */
export function tagError(text: string): string {
  if (text.includes(",")) return "A tag has no comma: add one tag after the other.";
  return text.length > TAG_LETTERS ? `A tag has at most ${TAG_LETTERS} letters.` : "";
}
