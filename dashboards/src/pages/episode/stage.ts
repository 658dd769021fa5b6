/**
 * The scene of a trace in WebGL: its meshes, their poses at a moment, and the camera that goes around them.
 * Loaded when it is first shown.
 * Points are metres of the scene, z up; three.js has y up, and the root of the scene turns one into the other.
 */
import {
  Box3, BufferGeometry, Float32BufferAttribute, LineBasicMaterial, LineSegments, MOUSE, Mesh, Object3D,
  PerspectiveCamera, Quaternion, Raycaster, Scene, ShaderMaterial, Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import type { Point } from "../../lib/trace";
import { LIGHT_FRAGMENT, LIGHT_VERTEX } from "./light";

export type Kind = "shell" | "receptacle" | "door" | "object" | "robot";
/** A thing of the scene as the file names it. */
export type BodyName = { id: string; kind: Kind; category: string; target: boolean; goal: boolean };
type Body = BodyName & { node: Object3D; meshes: Mesh[]; box: Box3 };
/** The poses of one node: one value for every time, which holds until the next. */
type Track = {
  node: Object3D; property: "position" | "quaternion" | "scale"; times: ArrayLike<number>; values: ArrayLike<number>; size: number;
};
type Look = { eye: Vector3; target: Vector3 };
/** A name above a thing, in pixels of the canvas. */
export type Label = { id: string; text: string; x: number; y: number };

export type Model = { root: Object3D; bodies: Body[]; tracks: Track[]; head: Object3D | null };

/** Told of what happens in the view. */
export interface Listener {
  /** The camera was moved by hand and stands still again. */
  settled(eye: Point, lookAt: Point): void;
  /** Told after each drawing, with the labels that stand in it. */
  drawn(labels: Label[]): void;
}

/** Nearer than this, the robot is not drawn: the camera stands in its head. */
const HEAD_M = 0.4;
/** How far the camera that goes with the robot stays away from a wall. */
const WALL_M = 0.15;
/** The size of a label, about. */
const LABEL_PX = [80, 22] as const;
const TRANSITION_MS = 200;
/** How long the camera stands still before its place is told. */
const SETTLE_MS = 250;
/** A 4:3 image of the simulator is 480 pixels high at a focal length of 400. */
const FIELD_DEGREES = (2 * Math.atan(240 / 400) * 180) / Math.PI;
const PIXEL_RATIO_MAX = 2;
/** The scene is as bright in a dark page as in a light one, and so are its lines. */
const COLORS = { target: 0xc2281c, goal: 0x0f7a70, pointed: 0x1d2226, path: 0x1d2226, view: 0x0f7a70 };

/** Reads a file of `GET /api/traces/{trace}/scene.glb`. */
export async function modelOf(bytes: ArrayBuffer): Promise<Model> {
  const { scene: root, animations } = await new GLTFLoader().parseAsync(bytes, "");
  root.updateMatrixWorld(true);
  const bodies: Body[] = [];
  const nodes = new Map<string, Object3D>();
  let head: Object3D | null = null;
  root.traverse((node) => {
    nodes.set(node.name || node.uuid, node);
    const { kind, name, category, target, goal } = node.userData;
    if (kind) {
      const named = { id: name ?? node.name, kind, category: category ?? "", target: !!target, goal: !!goal };
      bodies.push({ ...named, node, ...meshesOf(node) });
    }
    if (node instanceof PerspectiveCamera) head = node;
  });
  const tracks = animations.flatMap((animation) => animation.tracks.flatMap((track): Track[] => {
    const dot = track.name.lastIndexOf(".");
    const node = nodes.get(track.name.slice(0, dot));
    const property = track.name.slice(dot + 1) as Track["property"];
    return node ? [{ node, property, times: track.times, values: track.values, size: track.getValueSize() }] : [];
  }));
  return { root, bodies, tracks, head };
}

/** The meshes of a body without those of the bodies in it, and the box around them in its own frame. */
function meshesOf(node: Object3D): { meshes: Mesh[]; box: Box3 } {
  const meshes: Mesh[] = [];
  const visit = (one: Object3D) => {
    if (one !== node && one.userData["kind"]) return;
    if (one instanceof Mesh) meshes.push(one);
    one.children.forEach(visit);
  };
  visit(node);
  const into = node.matrixWorld.clone().invert();
  const box = new Box3();
  for (const { geometry, matrixWorld } of meshes) {
    geometry.computeBoundingBox();
    box.union(geometry.boundingBox!.clone().applyMatrix4(matrixWorld.clone().premultiply(into)));
  }
  return { meshes, box };
}

/** The place of the value that holds at a time. */
function keyAt(times: ArrayLike<number>, time: number): number {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= time + 1e-4) low = middle + 1;
    else high = middle;
  }
  return Math.max(0, low - 1);
}

/** The corners of a box, pair by pair along its edges. */
function edgesOf({ min, max }: Box3): number[] {
  const corner = (bits: number) => [bits & 1 ? max.x : min.x, bits & 2 ? max.y : min.y, bits & 4 ? max.z : min.z];
  return [0, 1, 2, 3, 4, 5, 6, 7].flatMap((from) =>
    [1, 2, 4].flatMap((axis) => (from & axis ? [] : [...corner(from), ...corner(from | axis)])));
}

function linesOf(positions: number[], color: number, width: number, through: boolean): LineSegments2 {
  const material = new LineMaterial({ color, linewidth: width, depthTest: !through });
  const lines = new LineSegments2(new LineSegmentsGeometry(), material);
  lines.geometry.setPositions(positions);
  lines.frustumCulled = false;
  if (through) lines.renderOrder = 1;
  return lines;
}

/** Stages that show one moment side by side: one camera moves all. */
const stages = new Set<Stage>();

export class Stage {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(FIELD_DEGREES, 4 / 3, 0.03, 100);
  private readonly controls: OrbitControls;
  private readonly material =
    new ShaderMaterial({ vertexShader: LIGHT_VERTEX, fragmentShader: LIGHT_FRAGMENT, vertexColors: true });
  private readonly marked: { body: Body; text: string; lines: LineSegments2 }[];
  private readonly pointer: LineSegments2;
  private readonly sight: LineSegments | null;
  private path: LineSegments2 | null = null;
  private readonly watch: ResizeObserver;
  private readonly bodyOf = new Map<Object3D, Body>();
  private frame = 0;
  private settling: ReturnType<typeof setTimeout> | undefined;
  /** Whether a hand holds the camera, and whether it moved it since its place was told. */
  private holding = false;
  private unsettled = false;
  /** Whether the camera is placed by the page instead of by hand. */
  private placing = false;
  private moment: number | null = null;
  private held: string | undefined;
  /** What is on its way: from where, to where, since when. */
  private transition: { begun: number; step: (share: number) => void } | null = null;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly model: Model,
    private readonly listener: Listener,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.scene.add(model.root);
    for (const body of model.bodies) {
      for (const mesh of body.meshes) {
        mesh.material = this.material;
        this.bodyOf.set(mesh, body);
      }
    }
    this.marked = model.bodies.filter(({ target, goal, kind }) => (target || goal) && kind !== "door").map((body) => {
      const color = body.target ? COLORS.target : COLORS.goal;
      const lines = linesOf(edgesOf(body.box.clone().expandByScalar(0.01)), color, 2.5, true);
      body.node.add(lines);
      return { body, text: body.target ? "target" : "destination", lines };
    });
    this.pointer = linesOf([0, 0, 0, 0, 0, 0], COLORS.pointed, 2, true);
    this.pointer.visible = false;
    this.sight = model.head instanceof PerspectiveCamera ? sightOf(model.head) : null;
    if (this.sight) model.head!.add(this.sight);

    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, {
      minDistance: 0.2, maxDistance: 40, maxPolarAngle: Math.PI * 0.75, screenSpacePanning: false, zoomSpeed: 1.4,
    });
    this.controls.mouseButtons = { LEFT: MOUSE.ROTATE, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };
    this.controls.addEventListener("start", () => {
      this.arrive();
      this.holding = true;
    });
    this.controls.addEventListener("end", () => {
      this.holding = false;
      if (this.unsettled) this.settle();
    });
    this.controls.addEventListener("change", () => {
      this.draw();
      if (!this.placing) this.moved();
    });
    this.canvas.addEventListener("webglcontextrestored", this.draw);
    this.watch = new ResizeObserver(() => this.resize());
    this.watch.observe(canvas);
    this.resize();
    stages.add(this);
  }

  /** Shows a moment: 0 is the start, k + 1 what came of step k. Its neighbours come smoothly where that is wanted. */
  show(moment: number, path: Point[], held: string | undefined, smooth: boolean) {
    this.held = held;
    const near = this.moment !== null && Math.abs(moment - this.moment) === 1;
    this.moment = moment;
    const steps = this.model.tracks.map(({ node, property, times, values, size }) => {
      const at = keyAt(times, moment) * size;
      if (property === "quaternion") {
        const [from, to] = [node.quaternion.clone(), new Quaternion().fromArray(values, at)];
        return (share: number) => node.quaternion.slerpQuaternions(from, to, share);
      }
      const [from, to] = [node[property].clone(), new Vector3().fromArray(values, at)];
      return (share: number) => node[property].lerpVectors(from, to, share);
    });
    this.begin(smooth && near, (share) => steps.forEach((step) => step(share)));
    this.showPath(path);
  }

  private showPath(path: Point[]) {
    if (this.path) {
      this.path.removeFromParent();
      dispose(this.path);
      this.path = null;
    }
    const parts = path.slice(1).flatMap((to, index) => [...this.world(path[index]!), ...this.world(to)]);
    if (!parts.length) return;
    this.path = linesOf(parts, COLORS.path, 3, false);
    this.scene.add(this.path);
  }

  /** Begins something that takes a moment, with the camera's own way where one is on its way already. */
  private begin(smooth: boolean, step: (share: number) => void) {
    if (!smooth) {
      this.transition = null;
      step(1);
    } else this.transition = { begun: performance.now(), step };
    this.draw();
  }

  /** Ends what is on its way at its end. */
  private arrive() {
    this.transition?.step(1);
    this.transition = null;
  }

  /** Places the camera, unless a hand moves it now. */
  look(eye: Point, lookAt: Point) {
    if (this.holding || this.unsettled) return;
    const to: Look = { eye: this.world(eye), target: this.world(lookAt) };
    // After a hand moved it, it is placed at the centimetres of the address: a reload shows the same pixels.
    if (this.camera.position.distanceTo(to.eye) < 1e-4 && this.controls.target.distanceTo(to.target) < 1e-4) return;
    const [from, way] = [{ eye: this.camera.position.clone(), target: this.controls.target.clone() }, this.transition];
    const step = (share: number) =>
      this.place({ eye: from.eye.clone().lerp(to.eye, share), target: from.target.clone().lerp(to.target, share) });
    // The camera that goes with the robot arrives when the robot does.
    if (way) this.transition = { begun: way.begun, step: (share) => { way.step(share); step(share); } };
    else step(1);
    this.draw();
  }

  /** Moves the camera by keyboard. */
  move(next: (eye: Point, lookAt: Point) => [Point, Point]) {
    this.arrive();
    const [eye, lookAt] = next(this.point(this.camera.position), this.point(this.controls.target));
    this.place({ eye: this.world(eye), target: this.world(lookAt) });
    this.moved();
  }

  private place({ eye, target }: Look) {
    this.placing = true;
    this.camera.position.copy(eye);
    this.controls.target.copy(target);
    this.controls.update();
    this.placing = false;
    this.draw();
  }

  private settle() {
    clearTimeout(this.settling);
    this.settling = setTimeout(() => {
      if (this.holding) return;
      this.unsettled = false;
      this.listener.settled(this.point(this.camera.position), this.point(this.controls.target));
    }, SETTLE_MS);
  }

  private moved() {
    this.unsettled = true;
    this.settle();
    for (const other of stages) {
      if (other !== this) other.place({ eye: this.camera.position, target: this.controls.target });
    }
  }

  /** A view from above that shows the whole scene. */
  above(): { eye: Point; lookAt: Point } {
    const shell = new Box3();
    const walls = this.model.bodies.filter(({ kind }) => kind === "shell");
    for (const { meshes } of walls.length ? walls : this.model.bodies) for (const mesh of meshes) shell.expandByObject(mesh);
    const [middle, size] = [shell.getCenter(new Vector3()), shell.getSize(new Vector3())];
    const half = Math.tan((FIELD_DEGREES * Math.PI) / 360);
    const up = (Math.max(size.z, (size.x * 3) / 4) / 2 / half) * 1.06 + shell.max.y;
    const [x, y] = this.point(middle);
    // Straight down has no direction that is up in the image.
    return { eye: [x, y - 0.05, up], lookAt: [x, y, 0] };
  }

  /** An eye as far from what it looks at, but higher and on this side of the wall, if a wall stands between them. */
  before(eye: Point, lookAt: Point): Point {
    const [dx, dy] = [eye[0] - lookAt[0], eye[1] - lookAt[1]];
    const level = Math.hypot(dx, dy);
    if (!level) return eye;
    const from = this.world(lookAt);
    const ray = new Raycaster(from, this.world([eye[0], eye[1], lookAt[2]]).sub(from).normalize(), 0, level + WALL_M);
    const walls = this.model.bodies.filter(({ kind }) => kind === "shell").flatMap(({ meshes }) => meshes);
    const [wall] = ray.intersectObjects(walls, false);
    if (!wall) return eye;
    const near = Math.max(0.1, wall.distance - WALL_M);
    const far = Math.hypot(level, eye[2] - lookAt[2]);
    const share = near / level;
    return [lookAt[0] + dx * share, lookAt[1] + dy * share, lookAt[2] + Math.sqrt(far * far - near * near)];
  }

  /** The body at a point of the canvas, with an outline around it; none where there is only floor and walls. */
  pointAt(x: number, y: number): BodyName | null {
    const { width, height } = this.canvas.getBoundingClientRect();
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2((x / width) * 2 - 1, 1 - (y / height) * 2), this.camera);
    const meshes = [...this.bodyOf].filter(([mesh]) => mesh.visible).map(([mesh]) => mesh);
    const [hit] = ray.intersectObjects(meshes, false);
    const body = hit ? this.bodyOf.get(hit.object)! : null;
    const named = body && body.kind !== "shell" ? body : null;
    this.outline(named);
    return named;
  }

  outline(body: Body | null) {
    if ((this.pointer.visible ? this.pointer.parent : null) === (body?.node ?? null)) return;
    this.pointer.visible = body !== null;
    if (body) {
      this.pointer.geometry.setPositions(edgesOf(body.box.clone().expandByScalar(0.02)));
      body.node.add(this.pointer);
    }
    this.draw();
  }

  /** No body is pointed at. */
  leave() {
    this.outline(null);
  }

  private resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, PIXEL_RATIO_MAX));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Draws once, when the browser next does. */
  private readonly draw = () => {
    this.frame ||= requestAnimationFrame((now) => {
      this.frame = 0;
      this.drawNow(now);
    });
  };

  private drawNow(now: number) {
    if (this.transition) {
      const { begun, step } = this.transition;
      const share = Math.min(1, Math.max(0, (now - begun) / TRANSITION_MS));
      step(share * (2 - share));
      if (share === 1) this.transition = null;
      else this.draw();
    }
    this.model.root.updateMatrixWorld(true);
    const head = this.model.head?.getWorldPosition(new Vector3());
    const inside = head !== undefined && head.distanceTo(this.camera.position) < HEAD_M;
    // The robot's images show neither itself nor what it holds.
    for (const { id, kind, meshes } of this.model.bodies) {
      const unseen = inside && (kind === "robot" || (kind === "object" && id === this.held));
      for (const mesh of meshes) mesh.visible = !unseen;
    }
    for (const { body, lines } of this.marked) lines.visible = !inside || body.id !== this.held;
    if (this.sight) this.sight.visible = !inside;
    this.renderer.render(this.scene, this.camera);
    this.listener.drawn(this.labels());
  }

  private labels(): Label[] {
    const { clientWidth, clientHeight } = this.canvas;
    const labels: Label[] = [];
    for (const { body, text, lines } of this.marked) {
      if (!lines.visible) continue;
      const box = body.box.clone().applyMatrix4(body.node.matrixWorld);
      const at = box.getCenter(new Vector3()).setY(box.max.y).project(this.camera);
      if (at.z > 1 || Math.abs(at.x) > 1 || Math.abs(at.y) > 1) continue;
      const label = { id: body.id, text, x: ((at.x + 1) / 2) * clientWidth, y: ((1 - at.y) / 2) * clientHeight };
      // One stands above the other where they would overlap.
      const [wide, high] = LABEL_PX;
      const other = labels.find(({ x, y }) => Math.abs(x - label.x) < wide && Math.abs(y - label.y) < high);
      labels.push(other ? { ...label, y: other.y - high } : label);
    }
    return labels;
  }

  private frameOfScene(): Object3D {
    return this.model.bodies[0]?.node.parent ?? this.model.root;
  }
  private world(point: Point): Vector3 {
    return this.frameOfScene().localToWorld(new Vector3(...point));
  }
  private point(at: Vector3): Point {
    return this.frameOfScene().worldToLocal(at.clone()).toArray();
  }

  dispose() {
    stages.delete(this);
    cancelAnimationFrame(this.frame);
    clearTimeout(this.settling);
    this.watch.disconnect();
    this.controls.dispose();
    this.canvas.removeEventListener("webglcontextrestored", this.draw);
    this.scene.traverse(dispose);
    this.material.dispose();
    this.renderer.dispose();
    // Browsers allow a few contexts only; this one is not left to their collection of garbage.
    this.renderer.forceContextLoss();
  }
}

function dispose(node: Object3D) {
  if (!(node instanceof Mesh || node instanceof LineSegments)) return;
  node.geometry.dispose();
  for (const material of [node.material].flat()) material.dispose();
}

/** What the robot's camera sees, as four edges and a frame, in that camera's own frame. */
function sightOf({ fov, aspect }: PerspectiveCamera): LineSegments {
  const far = 0.9;
  const up = far * Math.tan((fov * Math.PI) / 360);
  const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => [x! * up * aspect, y! * up, -far]);
  const lines = corners.flatMap((corner, index) => [0, 0, 0, ...corner, ...corner, ...corners[(index + 1) % 4]!]);
  const geometry = new BufferGeometry().setAttribute("position", new Float32BufferAttribute(lines, 3));
  return new LineSegments(geometry, new LineBasicMaterial({ color: COLORS.view }));
}

