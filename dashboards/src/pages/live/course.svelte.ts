/** The course of a session that a component shows, asked for when it can have changed. */
import { untrack } from "svelte";
import { asked, type Asked } from "../../lib/asked.svelte";
import { course, type Course, type Entry } from "./entry";

/** To be called while a component is made. */
export function following(entry: () => Entry): Asked<Course> {
  // Every poll brings a new object: only a new step or state changes what is asked for.
  const moment = $derived(`${entry().session} ${entry().state} ${entry().episodes} ${entry().steps} ${entry().task_id} ${entry().trace}`);
  return asked((signal) => {
    void moment;
    return untrack(() => course(entry(), signal));
  });
}
