/** The address is the state: which page, which thing, and everything that was chosen on it. */

type Value = string | number | boolean | null | undefined;
type Values = Record<string, Value | string[]>;

/** What a value is in an address: as often as it has values; empty ones are left out. */
function written(value: Value | string[]): string[] {
  if (Array.isArray(value)) return value;
  return value === null || value === undefined || value === "" || value === false ? [] : [String(value)];
}

class Route {
  path = $state(location.pathname);
  search = $state(location.search);
  /** Asks whether the page may be left, where it holds something that would be lost; null lets everything leave. */
  leave: (() => boolean) | null = null;

  /** What was chosen on the page. */
  get query(): URLSearchParams {
    return new URLSearchParams(this.search);
  }

  /** Parts of the path: ["episodes", "<trace>"]. */
  get parts(): string[] {
    return this.path.split("/").filter(Boolean).map(decoded);
  }

  /** Goes to a page of ours, unless the page that is shown wants to be kept. */
  go(address: string): void {
    if (this.leave && !this.leave()) return;
    history.pushState(null, "", address);
    this.read();
    window.scrollTo(0, 0);
  }

  /** Chooses something on this page. Empty values leave the address. `keep` makes it a place to come back to. */
  choose(values: Values, keep = false): void {
    const query = this.query;
    for (const [key, value] of Object.entries(values)) {
      query.delete(key);
      for (const one of written(value)) query.append(key, one);
    }
    const text = query.toString();
    const address = this.path + (text ? `?${text}` : "");
    if (keep) history.pushState(null, "", address);
    else history.replaceState(null, "", address);
    this.read();
  }

  /** Another address of the page that is shown already. */
  correct(address: string): void {
    history.replaceState(null, "", address);
    this.read();
  }

  read(): void {
    this.path = location.pathname;
    this.search = location.search;
  }
}

/** A part of an address; one that is written wrongly (`%zz`) stands for itself. */
function decoded(part: string): string {
  try {
    return decodeURIComponent(part);
  } catch {
    return part;
  }
}

export const route = new Route();

/** Listens to the browser's own buttons and to links of ours. */
export function follow(): () => void {
  const back = () => {
    const stays = location.pathname === route.path;
    if (stays || !route.leave || route.leave()) route.read();
    // The browser has gone already: the page that stays gets its address again.
    else history.pushState(null, "", route.path + route.search);
  };
  const click = (event: MouseEvent) => {
    const link = (event.target as Element | null)?.closest?.("a[href]") as HTMLAnchorElement | null;
    const plain = event.button === 0 && !event.metaKey && !event.ctrlKey && !event.shiftKey && !event.altKey;
    const ours = link && link.origin === location.origin && !link.target && !link.download && !/^\/(api|rerun)\//.test(link.pathname);
    if (!plain || !ours || event.defaultPrevented) return;
    if (link.hash && link.pathname === location.pathname && link.search === location.search) return;
    event.preventDefault();
    route.go(link.pathname + link.search + link.hash);
  };
  window.addEventListener("popstate", back);
  document.addEventListener("click", click);
  return () => {
    window.removeEventListener("popstate", back);
    document.removeEventListener("click", click);
  };
}

/** A link with parameters; empty ones are left out. */
export function link(path: string, values: Values = {}): string {
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(values)) {
    for (const one of written(value)) query.append(key, one);
  }
  const text = query.toString();
  return path + (text ? `?${text}` : "");
}
