/** Names on the map, placed so that none covers another; the important ones come first. */

export type Wanted = { id: string; x: number; y: number; half: number; strong: boolean };
export type Label = { id: string; x: number; y: number; strong: boolean };

type Box = { x0: number; x1: number; y0: number; y1: number };

/**
 * `size` is the height of a line, in the units of the map; `taken` is what no name may cover. Names that find no place are left
   out,
 * strong ones never.
 */
export function placed(wanted: Wanted[], size: number, left: number, right: number, taken: Box[]): Label[] {
  const labels: Label[] = [];
  for (const { id, x, y, half, strong } of wanted.toSorted((a, b) => Number(b.strong) - Number(a.strong))) {
    const wide = (id.length * size * 0.6) / 2;
    const middle = Math.min(right - wide, Math.max(left + wide, x));
    const places = [y, y + half + size * 0.7, y - half - size * 0.7].map((at) => ({
      x0: middle - wide, x1: middle + wide, y0: at - size / 2, y1: at + size / 2, at,
    }));
    const free = places.find((place) =>
      !taken.some((other) => place.x0 < other.x1 && other.x0 < place.x1 && place.y0 < other.y1 && other.y0 < place.y1));
    const chosen = free ?? (strong ? places[1] : undefined);
    if (!chosen) continue;
    taken.push(chosen);
    labels.push({ id, x: middle, y: chosen.at, strong });
  }
  return labels;
}
