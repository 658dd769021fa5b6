// An episode in a worker of its own.

import type { Answer, Answered, Camera, Opened, Request, Step, ToolCall, Verdict } from "./types.ts";
import type { ToWorker } from "./worker.ts";

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
  image: ImageData | null;
}

type Waiting = { resolve: (answered: Answered) => void; reject: (error: Error) => void };

/** A recorded episode that can be verified, drawn and branched. */
export class Episode {
  readonly #worker: Worker;
  readonly #waiting = new Map<number, Waiting>();
  #last = 0;
  /** What the trace says. */
  readonly opened: Opened;

  private constructor(worker: Worker, opened: Opened) {
    this.#worker = worker;
    this.opened = opened;
  }

  /**
   * Reads a trace (MCAP, as Reel records it). `worker` makes a worker of `worker.js`.
   * Rejects with the reason where the bytes are no sound trace.
   */
  static async open(module: WebAssembly.Module, worker: Worker, name: string, bytes: Uint8Array): Promise<Episode> {
    worker.postMessage({ module } satisfies ToWorker);
    const episode = new Episode(worker, undefined as unknown as Opened);
    worker.onmessage = ({ data }) => episode.#answered(data);
    worker.onerror = (event) => episode.#broken(new Error(event.message || "the worker could not start"));
    try {
      const { answer } = await episode.#request({ request: "open", name }, bytes);
      (episode as { opened: Opened }).opened = expect(answer, "opened");
    } catch (error) {
      worker.terminate();
      throw error;
    }
    return episode;
  }

  /** Executes every call again and compares each digest, text and image with the record. */
  async verify(onProgress: (progress: Progress) => void = () => {}): Promise<VerifyResult> {
    for (;;) {
      const { answer } = await this.#request({ request: "verify" });
      const { calls, of, verdict, text } = expect(answer, "verified");
      if (verdict) return { verdict, text: text ?? verdict.verdict };
      onProgress({ calls, of });
    }
  }

  /** What is seen from a camera after so many calls. */
  async view(at: number, camera: Camera): Promise<ImageData> {
    return image(await this.#request({ request: "view", at, camera }));
  }

  /** Begins another future after so many calls. */
  async branch(at: number): Promise<void> {
    expect((await this.#request({ request: "branch", at })).answer, "branched");
  }

  /** Makes a call in the other future. */
  async act(call: ToolCall): Promise<ActResult> {
    const { answer, bytes } = await this.#request({ request: "act", call });
    const { step, ended, image: size } = expect(answer, "acted");
    return { step, ended, image: size && pixels(bytes, size.width, size.height) };
  }

  /** What is seen from a camera in the other future. */
  async viewBranch(camera: Camera): Promise<ImageData> {
    return image(await this.#request({ request: "view_branch", camera }));
  }

  /** Ends the worker and frees its memory. */
  close(): void {
    this.#broken(new Error("the episode was closed"));
    this.#worker.terminate();
  }

  #request(request: Request, bytes?: Uint8Array): Promise<Answered> {
    const id = ++this.#last;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.#worker.postMessage({ id, request, ...(bytes && { bytes }) } satisfies ToWorker);
    });
  }

  #answered({ id, answer, bytes }: { id: number } & Answered): void {
    const waiting = this.#waiting.get(id);
    this.#waiting.delete(id);
    if (answer.answer === "failed") waiting?.reject(new Error(answer.reason));
    else waiting?.resolve({ answer, bytes });
  }

  #broken(error: Error): void {
    for (const { reject } of this.#waiting.values()) reject(error);
    this.#waiting.clear();
  }
}

function expect<A extends Answer["answer"]>(answer: Answer, expected: A): Extract<Answer, { answer: A }> {
  if (answer.answer !== expected) throw new Error(`the module answered ${answer.answer} instead of ${expected}`);
  return answer as Extract<Answer, { answer: A }>;
}

function image({ answer, bytes }: Answered): ImageData {
  const { width, height } = expect(answer, "image");
  return pixels(bytes, width, height);
}

function pixels(bytes: Uint8Array, width: number, height: number): ImageData {
  return new ImageData(new Uint8ClampedArray(bytes.buffer as ArrayBuffer), width, height);
}
