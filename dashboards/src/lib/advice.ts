/** What a page says about an error: the message of the service, with advice that can be followed on a page. */

const LESS = "Ask for less: add a condition (WHERE), name fewer columns, or aggregate.";
const operator = (setting: string) => `Whoever runs the service sets this limit (${setting}).`;

/** An answer that ended before its last row; its status was sent already, so that nothing says which limit it was. */
export const BROKE_OFF = `The answer broke off at a limit of the service on rows, time or memory, or the connection was lost. ${LESS}`;

const RULES: [RegExp, (match: RegExpExecArray) => string][] = [
  [/stopped after (\d+) s, the limit on time/, ([, seconds]) => `Stopped after ${seconds} s, the limit on time. ${LESS} ${operator("limits.sql_timeout_s")}`],
  [/stopped at (\d+) bytes, the limit on memory/, ([, bytes]) => `Stopped at ${Math.round(Number(bytes) / 2 ** 20)} MiB, the limit on memory. ${LESS} ${operator("limits.sql_mib")}`],
  [/stopped at (\d+) rows, the limit on answers/, ([, rows]) => `Stopped at ${rows} rows, the limit on answers. Add a LIMIT, or aggregate. ${operator("limits.sql_rows")}`],
  [/the question ended its process/, () => `The question most likely took more memory than it may. ${LESS} ${operator("limits.sql_mib")}`],
  [/needs values for its parameters (.+)/, ([, names]) => `The question has parameters without a value: ${names}. Open it in SQL, fill them in beside “Run”, and save it as a panel.`],
];

/** Advice to use an option of the command line, which a page does not have. */
const OPTIONS = /[;,(]?\s*(?:raise|pass|use|see|try|give|set|with) [^;,.()]*--[a-z][\w-]*[^;,.()]*\)?/gi;

export function told(error: unknown): string {
  const message = error instanceof Error ? error.message : String(error);
  for (const [pattern, say] of RULES) {
    const match = pattern.exec(message);
    if (match) return say(match);
  }
  return message.split("\nValid fields are")[0]!.replace(OPTIONS, "");
}
