/** An answer that a page waits for: asked again when what it depends on changes, and dropped when the page moves on. */

export interface Asked<T> {
  /** The newest answer; while the next one is awaited, still the one before. */
  readonly value: T | undefined;
  readonly error: unknown;
  readonly busy: boolean;
  /** Asks once more. */
  again(): void;
  /** Stops waiting: neither an answer nor an error is left. */
  stop(): void;
}

/** To be called while a component is made. What `ask` reads before it first waits is what it depends on; null asks nothing. */
export function asked<T>(ask: (signal: AbortSignal) => Promise<T> | null): Asked<T> {
  let value = $state.raw<T>();
  let error = $state.raw<unknown>();
  let busy = $state(true);
  let turn = $state(0);
  let cancel = () => {};
  $effect(() => {
    void turn;
    const stop = new AbortController();
    const answer = ask(stop.signal);
    busy = answer !== null;
    if (answer === null) {
      value = undefined;
      error = undefined;
    }
    answer?.then(
      (got) => {
        if (stop.signal.aborted) return;
        value = got;
        error = undefined;
        busy = false;
      },
      (why: unknown) => {
        if (stop.signal.aborted) return;
        error = why;
        busy = false;
      },
    );
    cancel = () => {
      stop.abort();
      value = undefined;
      error = undefined;
      busy = false;
    };
    return () => stop.abort();
  });
  return {
    get value() { return value; },
    get error() { return error; },
    get busy() { return busy; },
    again: () => void (turn += 1),
    stop: () => cancel(),
  };
}
