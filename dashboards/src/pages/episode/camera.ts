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

/** Whether the image shows what came of the call, instead of what the robot saw when it chose it. */
export function showsAfter(query: URLSearchParams): boolean {
  return query.get("show") === "after";
}

/** The moment whose image is shown: that of a step is recorded after its call. */
export function frameMoment(moment: number, after: boolean): number {
  return after ? moment : Math.max(START, moment - 1);
}

/** When an image was taken, in words. */
export function whenText(moment: number, after: boolean): string {
  return moment === START ? "before the first call" : `${after ? "after" : "before"} step ${moment}`;
}

/** The meshes and poses of a trace: one file for all its moments. */
export function scenePath(trace: string): string {
  return `/api/traces/${encodeURIComponent(trace)}/scene.glb`;
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

/** Straight through the robot's camera. */
export function throughEyes(robot: Robot | undefined): { eye: string; lookAt: string } {
  if (!robot) return overShoulder(robot);
  const { camera: [x, y, z], yaw, pitch } = robot;
  const level = Math.cos(pitch);
  const ahead: Point = [x + level * Math.cos(yaw), y + level * Math.sin(yaw), z + Math.sin(pitch)];
  return { eye: pointText([x, y, z]), lookAt: pointText(ahead) };
}

/** The named views of the 3D camera, which stand in the address as its eye. The first two go with the robot. */
export const NAMED_VIEWS = { shoulder: "Over the shoulder", robot: "Through the robot's eyes", above: "From above" };
export type NamedView = keyof typeof NAMED_VIEWS;

/** The named view of an address; none where it says points. */
export function namedView({ eye, lookAt }: View): NamedView | null {
  if (parsePoint(eye) && parsePoint(lookAt)) return null;
  return eye in NAMED_VIEWS ? (eye as NamedView) : "shoulder";
}

/** Moves eye and what is looked at along the floor: `right` and `on` in metres. */
export function pan(eye: Point, lookAt: Point, right: number, on: number): [Point, Point] {
  const yaw = Math.atan2(lookAt[1] - eye[1], lookAt[0] - eye[0]);
  const [dx, dy] = [on * Math.cos(yaw) + right * Math.sin(yaw), on * Math.sin(yaw) - right * Math.cos(yaw)];
  return [[eye[0] + dx, eye[1] + dy, eye[2]], [lookAt[0] + dx, lookAt[1] + dy, lookAt[2]]];
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
