// The page: the module and perhaps an episode lie in the document itself, so it needs no network and no server.

import { Player } from "./player.ts";
import { hasVectors } from "./vectors.ts";

/** The worker's program, put here by build.mjs. */
declare const WORKER: string;

const root = document.querySelector("main")!;

/** The bytes in an element of the document: base64 of gzip. */
async function embedded(element: Element): Promise<Uint8Array> {
  const packed = Uint8Array.from(atob(element.textContent!.trim()), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** A file beside this page. */
async function fetched(address: string): Promise<Uint8Array> {
  const response = await fetch(new URL(address.split("/").map(encodeURIComponent).join("/"), location.href));
  if (!response.ok) throw new Error(`${address}: ${response.status} ${response.statusText}`);
  return new Uint8Array(await response.arrayBuffer());
}

async function begin(): Promise<void> {
  if (!hasVectors()) throw new Error("it needs a browser of 2023 or newer, with vector instructions in WebAssembly");
  const source = document.getElementById("reel-simd")!;
  const module = await WebAssembly.compile((await embedded(source)) as BufferSource);
  const address = URL.createObjectURL(new Blob([WORKER], { type: "text/javascript" }));
  const player = new Player(root, { module, worker: () => new Worker(address) });
  const read = async (file: File | undefined) => file && player.show(file.name, new Uint8Array(await file.arrayBuffer()));

  const drop = document.querySelector<HTMLElement>(".drop")!;
  drop.querySelector("input")!.onchange = (event) => read((event.target as HTMLInputElement).files?.[0]);
  document.ondragover = (event) => event.preventDefault();
  document.ondrop = (event) => {
    event.preventDefault();
    read(event.dataTransfer?.files[0]);
  };

  const episode = document.getElementById("episode");
  const beside = decodeURIComponent(location.hash.slice(1));
  if (episode) {
    const { name = "episode", calls } = episode.dataset;
    await player.show(name, await embedded(episode), calls === undefined ? undefined : Number(calls));
  }
  else if (beside) await player.show(beside, await fetched(beside));
  else root.textContent = "";
}

begin().catch((error) => {
  root.textContent = `This page cannot begin: ${error instanceof Error ? error.message : error}`;
});
