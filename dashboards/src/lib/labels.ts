/** Labels of episodes: what people and judges say, who labels in this browser, and how a label is taken back. */
import { get, post, remove } from "./api";
import type { LabelBody } from "./generated";

/** A row of table `labels`. */
export interface Label {
  episode_id: string;
  author: string;
  kind: "human" | "judge" | "injected" | "adjudicated";
  class: string;
  sub_class: string | null;
  step: number | null;
  confidence: number | null;
  note: string | null;
  at_ms: number;
  /** Whether it was given before the rule's answer was seen; null where nobody recorded that. */
  blind: boolean | null;
}

/** In a table, whether a label was given blind. */
export const blindness = ({ blind }: { blind: boolean | null }) => (blind === null ? "?" : blind ? "yes" : "no");

/** What people say of each episode, for a join: the adjudicated label, else the one on which all agree, else `disputed`. */
export const PEOPLE = `SELECT episode_id, string_agg(DISTINCT author, ', ' ORDER BY author) AS labelled_by,
    coalesce(max(coalesce(sub_class, class)) FILTER (WHERE kind = 'adjudicated'), CASE
      WHEN count(DISTINCT coalesce(sub_class, class)) = 1 THEN max(coalesce(sub_class, class))
      WHEN count(DISTINCT class) = 1 THEN max(class) ELSE 'disputed' END) AS label
    FROM labels WHERE kind IN ('human', 'adjudicated') GROUP BY episode_id`;

const AUTHOR = "reel-author";

export const author = {
  get: () => localStorage.getItem(AUTHOR) ?? "",
  set: (name: string) => localStorage.setItem(AUTHOR, name),
};

/** The labels of an episode, by all authors. */
export async function labelsOf(episode: string, signal?: AbortSignal): Promise<Label[]> {
  return (await get(`/api/labels?episode=${encodeURIComponent(episode)}`, signal)) as unknown as Label[];
}

export function removeLabel(episode: string, author: string): Promise<void> {
  return remove(`/api/labels/${encodeURIComponent(episode)}?author=${encodeURIComponent(author)}`);
}

/** A label that was stored, and how it is taken back. */
export interface Stored {
  label: LabelBody;
  /** The label of the same author that it replaced. */
  before: Label | undefined;
  undo(): Promise<void>;
}

/** Stores a label. What it replaced is asked for first, because the tables do not keep it. */
export async function store(label: LabelBody): Promise<Stored> {
  const earlier = await labelsOf(label.episode);
  const stored = await post("/api/labels", label);
  const author = stored.author ?? label.author ?? "";
  const own = earlier.filter((one) => one.author === author);
  const before = own.find(({ kind }) => kind === "human");
  const undo = async () => {
    // A deletion takes all labels of the author; one that adjudicates is stored again.
    if (!before) await removeLabel(label.episode, author);
    for (const one of before ? [before] : own) await post("/api/labels", bodyOf(one));
  };
  return { label: stored, before, undo };
}

function bodyOf({ episode_id, author, kind, class: name, sub_class, step, confidence, note, blind }: Label): LabelBody {
  return { episode: episode_id, author, class: name, sub_class, step, confidence, note, adjudicate: kind === "adjudicated", blind };
}
