/** How numbers and names are written, everywhere the same. */

export function percent(share: number | null | undefined, digits = 0): string {
  return share === null || share === undefined || Number.isNaN(share) ? "–" : `${(100 * share).toFixed(digits)}%`;
}

export function number(value: number | null | undefined, digits = 0): string {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  // As `toLocaleString("en")` has it, which takes 15 ms to get ready.
  const written = Math.abs(value).toFixed(digits);
  const [whole, part] = written.split(".");
  const grouped = whole!.replace(/\B(?=(\d{3})+$)/g, ",");
  return `${value < 0 && Number(written) !== 0 ? "−" : ""}${part ? `${grouped}.${part}` : grouped}`;
}

const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/** A time in milliseconds where its reader is, as `Nov 28, 04:55`; with its year if that is another one. `Intl` takes 25 to 45 ms to get ready. */
export function dateTime(ms: number): string {
  const time = new Date(ms);
  const year = time.getFullYear() === new Date().getFullYear() ? "" : `, ${time.getFullYear()}`;
  const clock = [time.getHours(), time.getMinutes()].map((part) => String(part).padStart(2, "0")).join(":");
  return `${MONTHS[time.getMonth()]} ${time.getDate()}${year}, ${clock}`;
}

export function signed(value: number | null | undefined, digits = 2): string {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const written = Math.abs(value).toFixed(digits);
  return Number(written) === 0 ? written : `${value < 0 ? "−" : "+"}${written}`;
}

/** `wrong_instance` as people read it. */
export function words(name: string | null | undefined): string {
  return name ? name.replaceAll("_", " ") : "–";
}

/** Wilson's interval of a share at 95%: [low, high]. */
export function wilson(hits: number, of: number): [number, number] {
  if (of === 0) return [0, 1];
  const z = 1.959964;
  const share = hits / of;
  const middle = (share + (z * z) / (2 * of)) / (1 + (z * z) / of);
  const half = (z / (1 + (z * z) / of)) * Math.sqrt((share * (1 - share)) / of + (z * z) / (4 * of * of));
  return [Math.max(0, middle - half), Math.min(1, middle + half)];
}
