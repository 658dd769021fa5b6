/** The whole answer to a question as a file, however many rows of it a page shows. */
import { BROKE_OFF } from "./advice";
import { ApiError, send } from "./api";
import type { AnswerFormat } from "./generated";

/** Reads the answer to its end; fails if it ends too early, so that no file is a part that looks whole. */
export async function wholeAnswer(
  sql: string, parameters: Record<string, string>, format: AnswerFormat, signal: AbortSignal, onread: (bytes: number) => void,
): Promise<Blob> {
  let read = 0;
  const count = new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>({
    transform(part, out) {
      read += part.length;
      onread(read);
      out.enqueue(part);
    },
  });
  try {
    const answer = await send("POST", "/api/sql", { sql, parameters, format }, signal);
    return await new Response(answer.body!.pipeThrough(count), { headers: { "content-type": answer.headers.get("content-type") ?? "" } }).blob();
  } catch (error) {
    if (signal.aborted || error instanceof ApiError) throw error;
    throw new Error(BROKE_OFF);
  }
}

export function saveFile(blob: Blob, name: string) {
  const address = URL.createObjectURL(blob);
  Object.assign(document.createElement("a"), { href: address, download: name }).click();
  // The browser reads the address after this click.
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
