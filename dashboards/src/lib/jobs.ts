/** Long work of the service. */
import { post } from "./api";

import type { Job, Work } from "./generated";

export type { Job, Work };

export function start(work: Work): Promise<Job> {
  return post("/api/jobs", work);
}
