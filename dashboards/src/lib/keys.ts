/** The keys of every page, for its help (`?`). The code that hears a key is named beside its group. */

export interface KeyGroup {
  title: string;
  /** Keys, separated by spaces, and what they do. */
  keys: [string, string][];
  /** Whether a page has them. */
  on(page: PageAddress): boolean;
}
export interface PageAddress {
  /** The parts of the path. */
  parts: string[];
  query: URLSearchParams;
}

const isEpisode = ({ parts }: PageAddress) => parts[0] === "episodes" && parts.length > 1;
const isEpisodes = ({ parts }: PageAddress) => parts[0] === "episodes" && parts.length === 1;
const isFailures = (tab: string) => ({ parts, query }: PageAddress) => parts[0] === "failures" && (query.get("tab") ?? "") === tab;

export const KEYS: KeyGroup[] = [
  // components/EpisodeTable.svelte
  {
    title: "List", on: (page) => isEpisodes(page) || isFailures("")(page),
    keys: [["j ↓", "next row"], ["k ↑", "previous row"], ["Enter", "opens the episode of the row"]],
  },
  { title: "Selection", on: isEpisodes, keys: [["x", "selects the row, or takes it out of the selection"]] },
  // pages/failures/Keys.svelte
  {
    title: "Labels", on: isFailures("label"),
    keys: [
      ["1 2 3 4", "class"], ["a … i", "sub-class of the chosen class"], ["Enter", "stores the label; pressed again, goes to the next episode"],
      ["u", "undoes the last label"], ["y", "agrees with the rule, where it is shown"], ["j k", "next, previous step"], ["n p", "next, previous episode"],
    ],
  },
  // pages/episode/Episode.svelte and Neighbours.svelte
  {
    title: "Episode", on: isEpisode,
    keys: [
      ["← →", "previous, next step"], ["k j", "the same"], ["Home End", "first, last step"], ["d", "decisive step"], ["b", "image before the call, or after it"],
      ["Space", "plays, or stops"], ["f", "fills the screen with the image"], ["1 2 3 4 5", "camera: head, top-down, following an object, free, 3D"],
      ["s", "stars the episode, or takes the star back"],
    ],
  },
  { title: "Episode of a list", on: (page) => isEpisode(page) && page.query.has("list"), keys: [["p n", "previous, next episode of the list"]] },
  { title: "Side by side", on: (page) => isEpisode(page) && (page.query.has("beside") || page.query.has("branch")), keys: [["x", "next difference"]] },
  // components/Zoom.svelte
  {
    title: "Image", on: (page) => isEpisode(page) && page.query.get("camera") !== "3d",
    keys: [["+ -", "enlarges, makes smaller"], ["0 Escape", "shows the whole image"], ["Shift ← → ↑ ↓", "moves an enlarged image"]],
  },
  // pages/episode/SceneView.svelte
  {
    title: "3D, with the focus on it", on: (page) => isEpisode(page) && page.query.get("camera") === "3d",
    keys: [["← → ↑ ↓", "goes around"], ["Shift ← → ↑ ↓", "moves along the floor"], ["+ -", "nearer, farther"]],
  },
  // pages/episode/FloorMap.svelte and pages/episode/Strip.svelte
  {
    title: "Map and strip of other calls, with the focus on them", on: isEpisode,
    keys: [["↓ ↑", "next, previous thing of the map, with its name"], ["→ ←", "next, previous step of the strip"], ["Enter", "lists the other calls of the step"]],
  },
  // pages/drive/Drive.svelte
  {
    title: "Be the robot", on: ({ parts }) => parts[0] === "drive" && parts.length > 1,
    keys: [["a … z", "tool, by the letter beside it"], ["0 … 9", "marker number"], ["Enter", "makes the call"]],
  },
  // pages/sql/Editor.svelte and editor.ts
  {
    title: "Editor", on: ({ parts }) => parts[0] === "sql",
    keys: [
      ["Ctrl Enter", "runs the question"], ["Ctrl Space", "completes the word"], ["Tab", "the same, after the beginning of a word"], ["Ctrl Z", "undoes"],
      ["Ctrl Y", "redoes"], ["F8", "goes to the error"], ["Escape Tab", "leaves the editor"],
    ],
  },
];
