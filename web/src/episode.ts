// An episode in a worker of its own.

import { Session, expect } from "./session.ts";
import type { Camera, Opened, Responded, Step, ToolCall, Verdict } from "./types.ts";

export interface Progress {
  calls: number;
  of: number;
}

export interface VerifyResult {
  verdict: Verdict;
  /** The verdict in words, as `reel replay` prints it. */
  text: string;
}

export interface ActResult {
  step: Step;
  /** Why the episode is over, where it is. */
  ended: string | null;
  /** Whether it reached its goal, once it is over and where anybody knows. */
  success: boolean | null;
  image: ImageData | null;
}

/** A recorded episode that can be verified, drawn and branched. */
export class Episode {
  readonly #session: Session;
  /** What the trace says. */
  readonly opened: Opened;

  private constructor(session: Session, opened: Opened) {
    this.#session = session;
    this.opened = opened;
  }

  /**
   * Reads a trace (MCAP, as Reel records it). `worker` is a new worker of `worker.js`.
   * Rejects with the reason where the bytes are no sound trace.
   */
  static async open(module: WebAssembly.Module, worker: Worker, name: string, bytes: Uint8Array): Promise<Episode> {
    const session = new Session(module, worker);
    try {
      const { response } = await session.request({ request: "open", name }, bytes);
      return new Episode(session, expect(response, "opened"));
    } catch (error) {
      session.close();
      throw error;
    }
  }

  /** Executes every call again and compares each digest, text and image with the record. */
  async verify(onProgress: (progress: Progress) => void = () => {}): Promise<VerifyResult> {
    for (;;) {
      const { response } = await this.#session.request({ request: "verify" });
      const { calls, of, verdict, text } = expect(response, "verified");
      if (verdict) return { verdict, text: text ?? verdict.verdict };
      onProgress({ calls, of });
    }
  }

  /** What is seen from a camera after so many calls. */
  async view(at: number, camera: Camera): Promise<ImageData> {
    return image(await this.#session.request({ request: "view", at, camera }));
  }

  /** Begins another future after so many calls. */
  async branch(at: number): Promise<void> {
    expect((await this.#session.request({ request: "branch", at })).response, "branched");
  }

  /** Makes a call in the other future. */
  async act(call: ToolCall): Promise<ActResult> {
    const { response, bytes } = await this.#session.request({ request: "act", call });
    const { step, ended, success, image: size } = expect(response, "acted");
    return { step, ended, success, image: size && pixels(bytes, size.width, size.height) };
  }

  /** What is seen from a camera in the other future. */
  async viewBranch(camera: Camera): Promise<ImageData> {
    return image(await this.#session.request({ request: "view_branch", camera }));
  }

  /** Ends the worker and frees its memory. */
  close(): void {
    this.#session.close();
  }
}

function image({ response, bytes }: Responded): ImageData {
  const { width, height } = expect(response, "image");
  return pixels(bytes, width, height);
}

function pixels(bytes: Uint8Array, width: number, height: number): ImageData {
  return new ImageData(new Uint8ClampedArray(bytes.buffer as ArrayBuffer), width, height);
}
