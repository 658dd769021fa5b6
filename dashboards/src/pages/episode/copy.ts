/** What can be copied of an episode. */
import { type CopyFormat, curlGet, markdownText, pythonGet, pythonText, quoted } from "../../lib/copy";
import { words } from "../../lib/format";
import { type Blame, type Episode, START } from "../../lib/trace";

export function episodeFormats(episode: Episode, blame: Blame | null, moment: number): CopyFormat[] {
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
      text: () => `[${markdownText(episode.task.instruction)}](${location.href}) by ${markdownText(episode.header.policy.name)}: ${outcome}.${markdownText(why)}`,
    },
  ];
}
