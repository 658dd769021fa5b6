/** What the page of an episode asks for first: asked while the page itself is still on its way. */
import { foresee } from "../../lib/api";
import { framePath } from "../../lib/trace";
import { frameMoment, momentOf, queryOf, scenePath, showsAfter, viewOf } from "./camera";

export function pathsOf(trace: string) {
  const trunk = `/api/traces/${encodeURIComponent(trace)}` as const;
  return {
    episode: `${trunk}/episode`, steps: `${trunk}/steps?limit=1000`, scene: `${trunk}/scene`, blame: `${trunk}/blame`,
  } as const;
}

/** The image comes first, or the scene in 3D: it takes longest. */
export function foreseeEpisode(trace: string, query: URLSearchParams) {
  const view = viewOf(query);
  const moment = frameMoment(momentOf(query), showsAfter(query));
  const seen = view.camera === "3d" ? scenePath(trace) : framePath(trace, moment, queryOf(view));
  foresee([seen, ...Object.values(pathsOf(trace))]);
}
