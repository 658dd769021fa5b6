/** Questions of agents that wait for a person. Every page counts them, also behind another tab. */
import { get } from "./api";
import type { Questions } from "./generated";
import { Poll } from "./poll.svelte";

const EVERY_MS = 2000;

export let questions: Poll<Questions>;

$effect.root(() => {
  questions = new Poll((signal) => get("/api/questions", signal), EVERY_MS, { hidden: true });
});
