/** Jobs of the service: every page knows the same list, and asks for it only while somebody can see it change. */
import { ApiError, get, post, remove } from "./api";
import type { Job, Work } from "./generated";

export type { Job, Work };

export const ended = ({ state }: Job) => state !== "waiting" && state !== "running";

/** Reports make the list large, so that while a job runs only that job is asked for. */
const RUNNING_MS = 1000;
const OPEN_MS = 10_000;

class Jobs {
  /** The newest first; undefined until the service has answered once. */
  list = $state.raw<Job[]>();
  error = $state.raw<unknown>();
  /** Whether the drawer is open. */
  open = $state(false);
  readonly active = $derived(this.list?.filter((job) => !ended(job)) ?? []);
  #listing = 0;

  find(id: number): Job | undefined {
    return this.list?.find((job) => job.id === id);
  }

  async start(work: Work): Promise<Job> {
    const job = await post("/api/jobs", work);
    await this.refresh();
    return job;
  }

  async cancel(id: number): Promise<void> {
    await remove(`/api/jobs/${id}`);
    await this.refresh();
  }

  async refresh(): Promise<void> {
    const turn = (this.#listing += 1);
    try {
      const list = await get("/api/jobs");
      // A later question has the newer answer.
      if (turn !== this.#listing) return;
      this.list = list;
      this.error = undefined;
    } catch (error) {
      this.error = error;
    }
  }

  /** Asks for the job at work; once it changes its state, others may have changed theirs. */
  async look(): Promise<void> {
    const job = this.active.find(({ state }) => state === "running") ?? this.active.at(-1);
    if (!job) return this.refresh();
    try {
      const now = await get(`/api/jobs/${job.id}`);
      if (now.state !== job.state) return await this.refresh();
      this.list = this.list?.map((other) => (other.id === now.id ? now : other));
      this.error = undefined;
    } catch (error) {
      // A service that was started again knows none of the jobs of before.
      if (error instanceof ApiError && error.status === 404) return this.refresh();
      this.error = error;
    }
  }
}

export const jobs = new Jobs();

$effect.root(() => {
  void jobs.refresh();
  const every = $derived(jobs.active.length ? RUNNING_MS : jobs.open ? OPEN_MS : 0);
  $effect(() => {
    if (!every) return;
    const pause = every;
    let over = false;
    let timer: ReturnType<typeof setTimeout>;
    const turn = async () => {
      if (!document.hidden) await jobs.look();
      // An answer that ends the work ends these turns too.
      if (!over) timer = setTimeout(() => void turn(), pause);
    };
    timer = setTimeout(() => void turn(), Math.min(pause, RUNNING_MS / 2));
    return () => {
      over = true;
      clearTimeout(timer);
    };
  });
});
