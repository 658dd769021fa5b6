/** What can be copied of an episode. */
import { type CopyFormat, curlGet, markdownText, pythonGet, pythonText, quoted } from "../../lib/copy";
import { words } from "../../lib/format";
import type { Remark } from "../../lib/remarks";
import { type Blame, type Episode, START } from "../../lib/trace";

export function episodeFormats(episode: Episode, blame: Blame | null, moment: number, remarks: Remark[]): CopyFormat[] {
  const { trace } = episode;
  // A branch beside it may have more steps.
  const step = Math.min(moment, episode.steps - 1);
  const path = `/api/traces/${encodeURIComponent(trace)}`;
  const file = `${trace}.mcap`;
  const outcome = !episode.end ? "did not end" : episode.end.metrics?.success ? "success" : words(episode.end.reason);
  const why = blame?.decisive ? ` Step ${blame.decisive.step}: ${blame.decisive.explanation}.` : "";
  return [
    { name: "Link", text: () => location.href },
    { name: "curl", text: () => curlGet(path, `-o ${quoted(file)}`) },
    {
      name: "Python",
      text: () => `${pythonGet(path, file)}
import reel
episode = reel.open(${pythonText(file)})${step === START ? "" : `\nprint(episode.steps[${step}])`}`,
    },
    {
      name: "Markdown",
      text: () => {
        const [title, policy] = [episode.task.instruction, episode.header.policy.name].map(markdownText);
        return `[${title}](${location.href}) by ${policy}: ${outcome}.${markdownText(why)}${remarkLines(remarks)}`;
      },
    },
  ];
}

/** Stars, tags and comments in Markdown, below the line that they are about; empty if there are none. */
function remarkLines(remarks: Remark[]): string {
  const of = (kind: Remark["kind"]) => remarks.filter((remark) => remark.kind === kind);
  const place = (step: number | null) => (step === null ? "" : `, step ${step}`);
  const names = of("star").map(({ author }) => author);
  const tags = [...new Set(of("tag").map(({ text }) => text))];
  const lines = [
    ...(names.length ? [`★ ${names.join(", ")}`] : []),
    ...(tags.length ? [`Tags: ${tags.join(", ")}`] : []),
    ...of("comment").map(({ author, step, text }) => `${author}${place(step)}: ${text.replace(/\s+/g, " ")}`),
  ];
  return lines.length ? `\n\n${lines.map((line) => `- ${markdownText(line)}`).join("\n")}` : "";
}
