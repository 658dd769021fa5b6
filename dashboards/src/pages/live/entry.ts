/** Live sessions and the questions that they ask people. */
export type { Question, Session as Entry } from "../../lib/generated";
