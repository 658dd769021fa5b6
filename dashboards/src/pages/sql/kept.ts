/** Questions that are too long for a link: this browser keeps them under a short hash. */

const KEY = "reel-questions";
/** Longest address that mail, chat and proxies pass on unharmed, in characters. */
export const LONGEST_ADDRESS = 2000;
/** Most questions that are kept, and most characters of all of them; the oldest ones go first. */
const MOST = 50;
const MOST_CHARACTERS = 1_000_000;

type Kept = [hash: string, text: string];

function all(): Kept[] {
  try {
    return JSON.parse(localStorage.getItem(KEY) ?? "[]") as Kept[];
  } catch {
    return [];
  }
}

/** 53 bits, which tells questions of one browser apart. */
function hashOf(text: string): string {
  let [a, b] = [0xdeadbeef, 0x41c6ce57];
  for (let at = 0; at < text.length; at += 1) {
    const code = text.charCodeAt(at);
    a = Math.imul(a ^ code, 2654435761);
    b = Math.imul(b ^ code, 1597334677);
  }
  a = Math.imul(a ^ (a >>> 16), 2246822507) ^ Math.imul(b ^ (b >>> 13), 3266489909);
  b = Math.imul(b ^ (b >>> 16), 2246822507) ^ Math.imul(a ^ (a >>> 13), 3266489909);
  return ((b & 0x1fffff) * 2 ** 32 + (a >>> 0)).toString(36);
}

/** The question under a hash, if this browser keeps it. */
export function keptQuestion(hash: string): string | undefined {
  return all().find(([known]) => known === hash)?.[1];
}

/** Keeps a question and returns its hash; null if the browser keeps nothing. */
export function keepQuestion(text: string): string | null {
  const hash = hashOf(text);
  let room = MOST_CHARACTERS;
  const kept = [[hash, text] as Kept, ...all().filter(([known]) => known !== hash)].slice(0, MOST).filter((one) => (room -= one[1].length) >= 0);
  try {
    localStorage.setItem(KEY, JSON.stringify(kept));
    return keptQuestion(hash) === text ? hash : null;
  } catch {
    return null;
  }
}
