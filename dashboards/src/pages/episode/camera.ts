/** The cameras of an episode, how the free one moves, and the image that an address asks for. */
import { link } from "../../lib/route.svelte";
import { START, type Point, type Robot } from "../../lib/trace";

export type View = { camera: string; eye: string; lookAt: string };

export function viewOf(query: URLSearchParams): View {
  return { camera: query.get("camera") ?? "head", eye: query.get("eye") ?? "", lookAt: query.get("look_at") ?? "" };
}

/** The moment that is asked for, whether the episode has it or not. */
export function momentOf(query: URLSearchParams): number {
  const step = Number.parseInt(query.get("step") ?? "", 10);
  return Number.isNaN(step) ? START : Math.max(START, step);
}

/** The trace that stands beside the episode; nothing if none does. Addresses from before call it `branch`. */
export function besideName(query: URLSearchParams): string {
  return query.get("beside") ?? query.get("branch") ?? "";
}

/** Whether the image shows what came of the call, instead of what the robot saw when it chose it. Episodes are compared by what came. */
export function showsAfter(query: URLSearchParams): boolean {
  return (query.get("show") ?? (besideName(query) ? "after" : "before")) === "after";
}

/** The moment whose image is shown: that of a step is recorded after its call. */
export function frameMoment(moment: number, after: boolean): number {
  return after ? moment : Math.max(START, moment - 1);
}

export function queryOf({ camera, eye, lookAt }: View): string {
  if (camera === "head") return "";
  return camera === "free" ? link("", { camera, eye, look_at: lookAt }) : link("", { camera });
}

export function parsePoint(text: string): Point | null {
  const numbers = text.split(",").map((part) => (part.trim() === "" ? Number.NaN : Number(part)));
  return numbers.length === 3 && numbers.every(Number.isFinite) ? (numbers as Point) : null;
}

export function pointText(point: Point): string {
  return point.map((value) => String(Math.round(value * 100) / 100)).join(",");
}

/** A view over the robot's shoulder, to begin with. */
export function overShoulder(robot: Robot | undefined): { eye: string; lookAt: string } {
  const [x, y] = robot?.base ?? [0, 0];
  const yaw = robot?.yaw ?? 0;
  const eye: Point = [x - 2.2 * Math.cos(yaw), y - 2.2 * Math.sin(yaw), 2.6];
  return { eye: pointText(eye), lookAt: pointText([x + Math.cos(yaw), y + Math.sin(yaw), 0.6]) };
}

/** Goes around what is looked at: by `turn` about the vertical and by `lift` up, in radians. */
export function orbit(eye: Point, lookAt: Point, turn: number, lift: number): Point {
  const [dx, dy, dz] = [eye[0] - lookAt[0], eye[1] - lookAt[1], eye[2] - lookAt[2]];
  const far = Math.hypot(dx, dy, dz) || 1;
  const around = Math.atan2(dy, dx) + turn;
  const up = Math.min(1.5, Math.max(-0.3, Math.asin(dz / far) + lift));
  return [
    lookAt[0] + far * Math.cos(up) * Math.cos(around),
    lookAt[1] + far * Math.cos(up) * Math.sin(around),
    Math.max(0.05, lookAt[2] + far * Math.sin(up)),
  ];
}

/** Comes nearer (below 1) or goes away. */
export function dolly(eye: Point, lookAt: Point, factor: number): Point {
  const far = Math.hypot(eye[0] - lookAt[0], eye[1] - lookAt[1], eye[2] - lookAt[2]) || 1;
  const scale = Math.min(20, Math.max(0.3, far * factor)) / far;
  return eye.map((value, axis) => lookAt[axis]! + (value - lookAt[axis]!) * scale) as Point;
}
