/** What changes by itself: asked again and again while somebody looks, one request at a time. */

export class Poll<T> {
  value = $state.raw<T | undefined>();
  /** What went wrong the last time; the last good value stays. */
  error = $state.raw<unknown>();
  #look: () => void = () => {};

  /** To be made while a component begins. */
  constructor(ask: (signal: AbortSignal) => Promise<T>, every: number) {
    $effect(() => {
      const stop = new AbortController();
      let timer: ReturnType<typeof setTimeout> | undefined;
      let busy = false;
      const look = async () => {
        clearTimeout(timer);
        if (busy || document.hidden) return;
        busy = true;
        try {
          const value = await ask(stop.signal);
          if (stop.signal.aborted) return;
          this.value = value;
          this.error = undefined;
        } catch (error) {
          if (stop.signal.aborted) return;
          this.error = error;
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
