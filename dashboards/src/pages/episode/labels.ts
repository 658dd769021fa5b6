/** Names on the map, placed so that none covers another; the important ones come first. */

export type Box = { x0: number; x1: number; y0: number; y1: number };
/** A name for what covers `box`. */
export type Wanted = { id: string; box: Box; strong: boolean };
export type Label = { id: string; x: number; y: number; strong: boolean };

const meet = (one: Box, other: Box) => one.x0 < other.x1 && other.x0 < one.x1 && one.y0 < other.y1 && other.y0 < one.y1;
const within = (value: number, low: number, high: number) => Math.min(high, Math.max(low, value));

/**
 * `size` is the height of a line, in the units of the map; all names stay inside `map`, and none covers what is `taken`. A name
 * keeps off the boxes of other receptacles where it can. Names that find no place are left out, strong ones never.
 */
export function placed(wanted: Wanted[], size: number, map: Box, taken: Box[]): Label[] {
  const labels: Label[] = [];
  for (const { id, box, strong } of wanted.toSorted((a, b) => Number(b.strong) - Number(a.strong))) {
    const half = (id.length * size * (strong ? 0.68 : 0.61)) / 2;
    const x = within((box.x0 + box.x1) / 2, map.x0 + half, map.x1 - half);
    const places = [(box.y0 + box.y1) / 2, box.y1 + size * 0.7, box.y0 - size * 0.7].map((at) => {
      const y = within(at, map.y0 + size / 2, map.y1 - size / 2);
      return { x0: x - half, x1: x + half, y0: y - size / 2, y1: y + size / 2, y };
    });
    const free = places.filter((place) => !taken.some((other) => meet(place, other)));
    const alone = free.find((place) => !wanted.some((other) => other.id !== id && meet(place, other.box)));
    const chosen = alone ?? free[0] ?? (strong ? places[1] : undefined);
    if (!chosen) continue;
    taken.push(chosen);
    labels.push({ id, x, y: chosen.y, strong });
  }
  return labels;
}
