/** What changes by itself: asked again and again while somebody looks, one request at a time. */
import { ApiError } from "./api";

export class Poll<T> {
  value = $state.raw<T | undefined>();
  /** What went wrong the last time; the last good value stays. */
  error = $state.raw<unknown>();
  #look: () => void = () => {};

  /** To be made while a component begins. `hidden` asks also while another tab is in front. */
  constructor(ask: (signal: AbortSignal) => Promise<T>, every: number, { hidden = false } = {}) {
    $effect(() => {
      const stop = new AbortController();
      let timer: ReturnType<typeof setTimeout> | undefined;
      let busy = false;
      const look = async () => {
        clearTimeout(timer);
        if (busy || (document.hidden && !hidden)) return;
        busy = true;
        try {
          const value = await ask(stop.signal);
          if (stop.signal.aborted) return;
          this.value = value;
          this.error = undefined;
        } catch (error) {
          if (stop.signal.aborted) return;
          this.error = error;
          // A page without a token is loaded again once it has one.
          if (error instanceof ApiError && error.status === 401) return;
        }
        busy = false;
        timer = setTimeout(() => void look(), every);
      };
      this.#look = () => void look();
      document.addEventListener("visibilitychange", this.#look);
      void look();
      return () => {
        stop.abort();
        clearTimeout(timer);
        document.removeEventListener("visibilitychange", this.#look);
      };
    });
  }

  /** Does not wait for the next turn. */
  now(): void {
    this.#look();
  }
}
