/** The training sets of the service. */
import { ApiError, get } from "./api";
import type { Export } from "./generated";

/** Empty where nothing was exported. */
export async function trainingSets(signal: AbortSignal): Promise<Export[]> {
  try {
    return await get("/api/exports", signal);
  } catch (error) {
    if (error instanceof ApiError && error.status === 404) return [];
    throw error;
  }
}
