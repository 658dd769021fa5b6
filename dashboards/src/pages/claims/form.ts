/** What a person writes in the form of a claim, what it says, and which field is wrong. */
import { told } from "../../lib/advice";
import { type Claim, evaluate, refused } from "../../lib/claims";
import type { Definition } from "../../lib/panel";

/** Everything as it is written. */
export interface Fields {
  title: string;
  text: string;
  of: string;
  by: "holds" | "pattern";
  holds: string;
  pattern: string;
  /** The shares that the sentence promises, in percent as somebody typed them; empty where it promises none. */
  least: string;
  most: string;
}
export type Field = Exclude<keyof Fields, "by" | "text">;
export type Mistakes = Partial<Record<Field, string>>;

const asPercent = (share: number | null | undefined) => (typeof share === "number" ? String(Number((100 * share).toFixed(6))) : "");
const asShare = (text: string) => Number(text.trim().replace(/%$/, "").replace(",", ".")) / 100;

export function fieldsOf({ title, text, claim }: Pick<Definition, "title" | "text" | "claim">): Fields {
  return {
    title, text: text ?? "", of: claim?.of ?? "", by: claim?.pattern ? "pattern" : "holds", holds: claim?.holds ?? "", pattern: claim?.pattern ?? "",
    least: asPercent(claim?.at_least), most: asPercent(claim?.at_most),
  };
}

/** The claim that the fields say; those that are empty are left out. */
export function claimOf({ of, by, holds, pattern, least, most }: Fields): Claim {
  const said = by === "holds" ? holds.trim() : pattern.trim();
  return {
    ...(of.trim() ? { of: of.trim() } : {}), [by]: said,
    ...(least.trim() ? { at_least: asShare(least) } : {}), ...(most.trim() ? { at_most: asShare(most) } : {}),
  };
}

/** What can be told without the service. */
export function mistakes(fields: Fields, titled: boolean): Mistakes {
  const wrong: Mistakes = {};
  if (titled && !fields.title.trim()) wrong.title = "Write the sentence that the episodes are to bear out.";
  if (!fields[fields.by].trim()) wrong[fields.by] = fields.by === "holds" ? "Write a condition on an episode." : "Write a pattern of calls.";
  for (const bound of ["least", "most"] as const) {
    const share = asShare(fields[bound]);
    if (fields[bound].trim() && !(share >= 0 && share <= 1)) wrong[bound] = `“${fields[bound]}” is no percentage from 0 to 100.`;
  }
  const both = !wrong.least && !wrong.most && fields.least.trim() && fields.most.trim();
  if (both && asShare(fields.least) > asShare(fields.most)) wrong.most = "The share cannot be promised to be at most less than it is at least.";
  return wrong;
}

/** The field that the service refuses, with what it says; nothing where it is another error. */
export async function mistakesOf(error: unknown, claim: Claim): Promise<Mistakes> {
  if (!refused(error)) return {};
  const said = claim.pattern ? "pattern" : "holds";
  let [field, message]: [Field, string] = [said, error.message];
  // A question that fails does not say which of its conditions is wrong; the counted episodes can be asked alone.
  if (claim.of) {
    try {
      await evaluate({ of: claim.of, holds: "true" });
    } catch (alone) {
      if (refused(alone)) [field, message] = ["of", alone.message];
    }
  }
  return { [field]: told(new Error(message)).replace(/^(Schema error|SQL error|Error during planning): /, "").replaceAll("'episode.", "'") };
}
