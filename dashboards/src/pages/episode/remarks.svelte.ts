/** Stars, tags and comments of the episode that a page shows, and what this browser's author does with them. */
import { type Asked, asked } from "../../lib/asked.svelte";
import { author } from "../../lib/labels";
import { type Change, type Remark, type RemarkKey, add, edit, remarksOf, take } from "../../lib/remarks";

export interface Tag {
  text: string;
  authors: string[];
}

export class EpisodeRemarks {
  /** Whoever remarks in this browser; empty until somebody says so. */
  name = $state(author.get());
  busy = $state(false);
  problem = $state("");
  /** The newest change, which can be taken back. */
  change = $state.raw<Change | null>(null);
  /** Whether somebody has to say who remarks here. */
  naming = $state(false);
  private named: (known: boolean) => void = () => {};
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

  /** To be made while a component is made; `episode` is null until the tables may be asked. */
  constructor(private readonly episode: () => string | null) {
    this.found = asked((signal) => {
      const id = episode();
      return id === null ? null : remarksOf(id, signal);
    });
  }

  /** All remarks in the order of time; undefined until they are known. */
  get all(): Remark[] | undefined {
    return this.found.value;
  }
  get error(): unknown {
    return this.found.error;
  }
  /** Whether the star that the page shows may be an older one: whoever toggled it would get another than they see. */
  get stale(): boolean {
    return this.busy || this.found.busy;
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
    this.named(false);
    this.naming = true;
    return new Promise((resolve) => (this.named = resolve));
  }
  /** Answers it; an empty name is none. */
  answerName(name: string) {
    this.naming = false;
    if (name) {
      this.name = name;
      author.set(name);
    }
    this.named(name !== "");
  }

  /** Stores a change, after asking for a name where none is known; false if it was not stored. */
  private async store(work: () => Promise<Change | null>): Promise<boolean> {
    if (this.busy) return false;
    if (!this.name && !(await this.askName())) return false;
    this.busy = true;
    this.problem = "";
    try {
      this.change = await work();
      this.name = author.get();
      this.readAgain();
      return true;
    } catch (error) {
      this.problem = error instanceof Error ? error.message : String(error);
      return false;
    } finally {
      this.busy = false;
    }
  }

  private key(kind: Remark["kind"], text = "", step: number | null = null): RemarkKey {
    return { episode_id: this.episode() ?? "", author: this.name, kind, text, step };
  }

  toggleStar() {
    if (!this.all || this.stale) return;
    const own = this.stars.find((star) => this.owns(star));
    void this.store(() => (own ? take(own) : add(this.key("star"))));
  }
  tag(text: string): Promise<boolean> {
    return this.store(() => add(this.key("tag", text)));
  }
  untag(text: string) {
    const own = this.of("tag").find((tag) => tag.text === text && this.owns(tag));
    if (own) void this.store(() => take(own));
  }
  comment(text: string, step: number | null): Promise<boolean> {
    return this.store(() => add(this.key("comment", text, step)));
  }
  reword(comment: Remark, text: string): Promise<boolean> {
    return this.store(() => edit(comment, text));
  }
  remove(comment: Remark) {
    void this.store(() => take(comment));
  }
  undo() {
    const last = this.change;
    if (last) void this.store(async () => { await last.undo(); return null; });
  }
}
