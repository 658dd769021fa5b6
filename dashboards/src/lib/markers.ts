/** Markers of an image: where their numbers and what they mark are drawn, so that a click can mean one. */
import { ApiError, get } from "./api";
import type { MarkerBox } from "./generated";
import { framePath, markersBefore, shortName, type Step } from "./trace";

export type { MarkerBox };

/** Corners of a rectangle of the image, inclusive: x and y of the first pixel and of the last. */
export type Box = MarkerBox["bbox"];

/** Width and height of every image of the simulator, in pixels. */
export const IMAGE = [640, 480] as const;

const area = ([x0, y0, x1, y1]: Box) => (x1 - x0 + 1) * (y1 - y0 + 1);

/** From large to small, so that where marked things overlap a click means the smallest. */
export function byArea(boxes: MarkerBox[]): MarkerBox[] {
  return boxes.toSorted((a, b) => area(b.bbox) - area(a.bbox));
}

/** The numbers that are drawn in the head camera's image of a moment; none where the service does not tell them. */
export async function markersOf(trace: string, moment: number, signal?: AbortSignal): Promise<MarkerBox[]> {
  try {
    return await get(`${framePath(trace, moment)}/markers`, signal);
  } catch (error) {
    if (error instanceof ApiError && error.status !== 0) return [];
    throw error;
  }
}

/** What the numbers in the image of a moment stand for. */
export function markerNames(steps: Step[], moment: number): Record<number, string> {
  return Object.fromEntries(markersBefore(steps, moment + 1).map(({ id, target }) => [id, shortName(target.id)]));
}
