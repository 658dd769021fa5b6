// A session in a worker of its own: requests go out with numbers, responses come back by them.

import type { Request, Responded, SessionResponse } from "./types.ts";
import type { ToWorker } from "./worker.ts";

type Waiting = { resolve: (responded: Responded) => void; reject: (error: Error) => void };

export class Session {
  readonly #worker: Worker;
  readonly #waiting = new Map<number, Waiting>();
  #last = 0;

  /** `worker` runs worker.js and belongs to this session. */
  constructor(module: WebAssembly.Module, worker: Worker) {
    this.#worker = worker;
    worker.onmessage = ({ data }) => this.#responded(data);
    worker.onerror = (event) => this.#broken(new Error(event.message || "the worker could not start"));
    worker.postMessage({ module } satisfies ToWorker);
  }

  /** Rejects with the reason where the session fails. */
  request(request: Request, bytes?: Uint8Array): Promise<Responded> {
    const id = ++this.#last;
    return new Promise((resolve, reject) => {
      this.#waiting.set(id, { resolve, reject });
      this.#worker.postMessage({ id, request, ...(bytes && { bytes }) } satisfies ToWorker);
    });
  }

  /** Ends the worker and frees its memory. */
  close(): void {
    this.#broken(new Error("the session was closed"));
    this.#worker.terminate();
  }

  #responded({ id, response, bytes }: { id: number } & Responded): void {
    const waiting = this.#waiting.get(id);
    this.#waiting.delete(id);
    if (response.response === "failed") waiting?.reject(new Error(response.reason));
    else waiting?.resolve({ response, bytes });
  }

  #broken(error: Error): void {
    for (const { reject } of this.#waiting.values()) reject(error);
    this.#waiting.clear();
  }
}

/** The response, which has to be of this kind. */
export function expect<R extends SessionResponse["response"]>(response: SessionResponse, expected: R): Extract<SessionResponse, { response: R }> {
  if (response.response !== expected) throw new Error(`the module responded ${response.response} instead of ${expected}`);
  return response as Extract<SessionResponse, { response: R }>;
}
