// A bundle in a worker of its own: a whole run, executed again episode by episode.

import { Session, expect } from "./session.ts";
import type { Finding, Manifest, Verification } from "./types.ts";

/** A benchmark run in one file (docs/proof.md). */
export class Bundle {
  readonly #session: Session;
  /** What the bundle claims. */
  readonly manifest: Manifest;
  /** What does not hold before anything is executed. */
  readonly findings: Finding[];

  private constructor(session: Session, manifest: Manifest, findings: Finding[]) {
    this.#session = session;
    this.manifest = manifest;
    this.findings = findings;
  }

  /** Reads a bundle. `worker` is a new worker of `worker.js`. Rejects with the reason where the bytes are none. */
  static async open(module: WebAssembly.Module, worker: Worker, bytes: Uint8Array): Promise<Bundle> {
    const session = new Session(module, worker);
    try {
      const { response } = await session.request({ request: "open_bundle" }, bytes);
      const { manifest, findings } = expect(response, "opened_bundle");
      return new Bundle(session, manifest, findings);
    } catch (error) {
      session.close();
      throw error;
    }
  }

  /** Executes an episode again; what differs from the claim. */
  async execute(episode: number): Promise<Finding[]> {
    return expect((await this.#session.request({ request: "execute", episode })).response, "executed").findings;
  }

  /** The trace of an episode, with the name that its file had. */
  async unpack(episode: number): Promise<{ name: string; bytes: Uint8Array }> {
    const { response, bytes } = await this.#session.request({ request: "unpack", episode });
    return { name: expect(response, "unpacked").name, bytes };
  }

  /** Whether it holds, with what was executed; nothing can be executed afterwards. */
  async conclude(): Promise<{ verification: Verification; text: string }> {
    return expect((await this.#session.request({ request: "conclude" })).response, "concluded");
  }

  /** Ends the worker and frees its memory. */
  close(): void {
    this.#session.close();
  }
}
