// Requests and answers of a session, as src/web/src/session.rs reads and writes them.

/** A call of a tool. */
export interface ToolCall {
  name: string;
  arguments: unknown;
}

/** From where an image is drawn. `free` needs both points: x, y, z in metres in the scene's frame, z up. */
export interface Camera {
  name: "head" | "top-down" | "free" | `follow:${string}`;
  eye?: Point;
  look_at?: Point;
}

export type Point = [number, number, number];

/** `at` counts calls: 0 is before the first. */
export type Request =
  | { request: "open"; name: string }
  | { request: "verify" }
  | { request: "view"; at: number; camera: Camera }
  | { request: "branch"; at: number }
  | { request: "act"; call: ToolCall }
  | { request: "view_branch"; camera: Camera }
  | { request: "open_bundle" }
  | { request: "execute"; episode: number }
  | { request: "conclude" }
  | { request: "unpack"; episode: number };

export interface Size {
  width: number;
  height: number;
}

/** What a replay found, as `reel replay --json` prints it. */
export type Verdict =
  | { verdict: "exact"; calls: number; physics_steps: number; images: number }
  | { verdict: "diverged"; [field: string]: unknown }
  | { verdict: "other_simulator"; recorded: number; current: number; changes: string[] }
  | { verdict: "not_replayable"; reason: string }
  | { verdict: "refused"; reason: string };

/** One call with what came of it; further fields as in the trace (docs/spec.md). */
export interface Step {
  step: number;
  input: { call: ToolCall; policy?: { reasoning: string; raw: string } };
  outcome: { text: string; error?: string };
  changes: { physics: unknown[]; registry: unknown[] };
  reward: { component: string; value: number; reason: string }[];
  robot: { base: [number, number]; yaw: number; camera: Point };
  held: string | null;
}

export interface End {
  reason: string;
  metrics: { length: number; completion: number; total_reward: number; asks: number };
}

export interface Tool {
  name: string;
  argument: string | null;
  description: string;
}

/** What a trace says before anything is executed. */
export interface Opened {
  header: { episode_id: string; task_id: string; scene_id: string; family: string; seed: number; profile: string; reward_preset: string; sim_version: number; policy: { name: string } };
  instruction: string;
  steps: Step[];
  end: End | null;
  success: boolean | null;
  /** Digest of the hash chain: what a verdict is about. */
  trace: string;
  /** BLAKE3 of the file. */
  file: string;
  tools: Tool[];
  receptacles: string[];
  /** Version of Reel and of the simulator in this module. */
  build: string;
}

/** Something that does not hold in a bundle. */
export interface Finding {
  kind: string;
  /** Number of the episode in the bundle, where it is about one. */
  episode: number | null;
  /** The task, where it is about one of the grid. */
  task?: string;
  text: string;
}

/** What a bundle claims; further fields as in its manifest.json (docs/proof.md). */
export interface Manifest {
  name: string;
  build: string;
  simulator: number;
  settings: { policy: { name: string }; profile: string; skills: string; preset: string };
  episodes: { task: string; seed: number; success: boolean; completion: number; reward: number; length: number }[];
  results: { family: string; episodes: number; played: number; successes: number; success_rate: number; success_low: number; success_high: number }[];
}

/** Whether a bundle holds, as `reel verify --json` prints it. */
export interface Verification {
  holds: boolean;
  signer: string | null;
  findings: Finding[];
  episodes: number;
}

export type SessionResponse =
  | ({ response: "opened" } & Opened)
  | { response: "verified"; calls: number; of: number; verdict: Verdict | null; text: string | null }
  | ({ response: "image" } & Size)
  | { response: "branched"; at: number }
  | { response: "acted"; step: Step; ended: string | null; success: boolean | null; image: Size | null }
  | { response: "opened_bundle"; manifest: Manifest; findings: Finding[] }
  | { response: "executed"; findings: Finding[] }
  | { response: "concluded"; verification: Verification; text: string }
  | { response: "unpacked"; name: string }
  | { response: "failed"; reason: string };

/** A response with the bytes beside it: RGBA of an image. */
export interface Responded {
  response: SessionResponse;
  bytes: Uint8Array;
}
