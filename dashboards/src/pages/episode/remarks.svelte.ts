/** Stars, tags and comments of the episode that a page shows, and what this browser's author does with them. */
import { onDestroy } from "svelte";
import { type Asked, asked } from "../../lib/asked.svelte";
import { author } from "../../lib/labels";
import { type Change, type Remark, type RemarkKey, adding, changed, opposite, remarksOf, rewording, storeChange, taking } from "../../lib/remarks";
import { EarlierChange, takeOver } from "./earlier.svelte";

export interface Tag {
  text: string;
  authors: string[];
}

export class EpisodeRemarks {
  /** Whoever remarks in this browser; empty until somebody says so. */
  name = $state(author.get());
  problem = $state("");
  /** A comment that is being written; it stays while the transcript shows. */
  draft = $state("");
  /** The newest change, which can be taken back. */
  change = $state.raw<Change | null>(null);
  /** Whether somebody has to say who remarks here. */
  naming = $state(false);
  private named: ((known: boolean) => void)[] = [];
  /** How many changes the service has not taken yet: it gets them one after the other, while the page shows them at once. */
  private unsent = $state(0);
  private sending: Promise<unknown> = Promise.resolve();
  /** Changes that the newest answer of the service does not have yet. */
  private unread = $state.raw<{ change: Change; at_ms: number }[]>([]);
  /** What is there since the last change; undefined before the first. */
  private fresh = $state.raw<Remark[]>();
  readonly stars = $derived.by(() => this.of("star"));
  readonly comments = $derived.by(() => this.of("comment"));
  readonly tags = $derived.by((): Tag[] => {
    const tags = this.of("tag");
    const authors = (text: string) => tags.filter((tag) => tag.text === text).map((tag) => tag.author);
    return [...new Set(tags.map((tag) => tag.text))].map((text) => ({ text, authors: authors(text) }));
  });
  /** How many comments are about each step that has some. */
  readonly steps = $derived.by(() => {
    const counts = new Map<number, number>();
    for (const { step } of this.comments) if (step !== null) counts.set(step, (counts.get(step) ?? 0) + 1);
    return counts;
  });
  readonly starred = $derived.by(() => this.stars.some((star) => this.owns(star)));
  private readonly found: Asked<Remark[]>;
  /** Everything that was changed on this page. */
  private readonly made: EarlierChange[] = [];
  /** Whether the star is to be turned as soon as it is known. */
  private starWanted = $state(false);

  /** To be made while a component is made; `trace` names the episode to people, and `episode` is null until the tables may be asked. */
  constructor(private readonly trace: string, private readonly episode: () => string | null) {
    this.found = asked((signal) => {
      const id = episode();
      return id === null ? null : remarksOf(id, signal);
    });
    $effect(() => {
      if (!this.starWanted || !this.all) return;
      this.starWanted = false;
      this.toggleStar();
    });
    onDestroy(() => this.leave());
  }

  /** The next page tells what this one cannot any more. */
  private leave() {
    const lost = this.starWanted ? "The page was left before it knew the stars of the episode."
      : this.naming ? "Nobody said under which name." : "";
    if (lost) {
      const change = new EarlierChange(this.trace, this.starWanted ? "Star turned." : "Change.");
      change.end(lost);
      this.made.push(change);
    }
    takeOver(this.made);
  }

  /** All remarks in the order of time; undefined until they are known. */
  get all(): Remark[] | undefined {
    const read = this.fresh ?? this.found.value;
    return read && this.unread.reduce((all, { change, at_ms }) => changed(all, change, at_ms), read);
  }
  get error(): unknown {
    return this.found.error;
  }
  /** Whether changes are on their way to the tables. */
  get busy(): boolean {
    return this.unsent > 0;
  }
  readAgain() {
    this.found.again();
  }

  /** Whether this browser's author made a remark. */
  owns({ author }: RemarkKey): boolean {
    return this.name !== "" && author === this.name;
  }

  private of(kind: Remark["kind"]): Remark[] {
    return (this.all ?? []).filter((remark) => remark.kind === kind);
  }

  /** Asks who remarks here; false if nobody says so. */
  askName(): Promise<boolean> {
    this.naming = true;
    return new Promise((resolve) => this.named.push(resolve));
  }
  /** Answers it; an empty name is none. Everything that was done meanwhile goes on. */
  answerName(name: string) {
    this.naming = false;
    if (name) {
      this.name = name;
      author.set(name);
    }
    for (const named of this.named.splice(0)) named(name !== "");
  }

  /** Shows a change and stores it, after asking for a name where none is known; false if it was not stored. */
  private async store(make: () => Change | null, undoing = false): Promise<boolean> {
    if (!this.name && !(await this.askName())) return false;
    const change = make();
    if (!change) return false;
    const shown = { change, at_ms: Date.now() };
    this.unread = [...this.unread, shown];
    this.change = undoing ? null : change;
    this.problem = "";
    this.unsent += 1;
    const fate = new EarlierChange(this.trace, undoing ? `Undone: ${change.done}` : change.done);
    this.made.push(fate);
    const sent = this.sending.then(() => storeChange(change));
    this.sending = sent.catch(() => {});
    try {
      await sent;
      this.name = author.get();
      fate.end();
      return true;
    } catch (error) {
      this.unread = this.unread.filter((one) => one !== shown);
      if (this.change === change) this.change = null;
      this.problem = error instanceof Error ? error.message : String(error);
      fate.end(this.problem);
      return false;
    } finally {
      this.unsent -= 1;
      if (!this.unsent) void this.read();
    }
  }

  /** Reads what is there; what was changed before is in it. */
  private async read() {
    const [id, known] = [this.episode(), this.unread];
    if (id === null) return;
    // Without an answer the page goes on to show what was stored.
    const fresh = await remarksOf(id).catch(() => null);
    if (!fresh || this.unsent) return;
    this.fresh = fresh;
    this.unread = this.unread.filter((one) => !known.includes(one));
  }

  private key(kind: Remark["kind"], text = "", step: number | null = null): RemarkKey {
    return { episode_id: this.episode() ?? "", author: this.name, kind, text, step };
  }

  toggleStar() {
    if (!this.all) {
      this.starWanted = !this.starWanted;
      return;
    }
    void this.store(() => {
      const own = this.stars.find((star) => this.owns(star));
      return own ? taking(own) : adding(this.key("star"));
    });
  }
  tag(text: string): Promise<boolean> {
    return this.store(() => adding(this.key("tag", text)));
  }
  untag(text: string) {
    const own = this.of("tag").find((tag) => tag.text === text && this.owns(tag));
    if (own) void this.store(() => taking(own));
  }
  comment(text: string, step: number | null): Promise<boolean> {
    return this.store(() => adding(this.key("comment", text, step)));
  }
  reword(comment: Remark, text: string): Promise<boolean> {
    return this.store(() => rewording(comment, text));
  }
  remove(comment: Remark) {
    void this.store(() => taking(comment));
  }
  undo() {
    const last = this.change;
    if (last) void this.store(() => opposite(last), true);
  }
}
