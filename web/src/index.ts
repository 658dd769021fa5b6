// The package: episodes in workers, and instances where the caller brings its own thread (Node).

export { Episode, type ActResult, type VerifyResult, type Progress } from "./episode.ts";
export { Bundle } from "./bundle.ts";
export { Instance } from "./instance.ts";
export { hasVectors, moduleName } from "./vectors.ts";
export type * from "./types.ts";
