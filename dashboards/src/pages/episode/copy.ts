/** Ways to take an episode along. */
import { type Way, curlGet, markdownText, pythonText } from "../../lib/copy";
import { words } from "../../lib/format";
import { type Blame, type Episode, START } from "../../lib/trace";

export function waysToEpisode(episode: Episode, blame: Blame | null, moment: number): Way[] {
  const { trace } = episode;
  const path = `/api/traces/${encodeURIComponent(trace)}`;
  const file = `${trace}.mcap`;
  const outcome = !episode.end ? "did not end" : episode.end.metrics?.success ? "success" : words(episode.end.reason);
  const why = blame?.decisive ? ` Step ${blame.decisive.step}: ${blame.decisive.explanation}.` : "";
  return [
    { name: "Link", text: () => location.href },
    { name: "curl", text: () => curlGet(path, `-o '${file}'`) },
    {
      name: "Python",
      text: () => `import urllib.request, reel
urllib.request.urlretrieve(${pythonText(location.origin + path)}, ${pythonText(file)})
episode = reel.open(${pythonText(file)})${moment === START ? "" : `\nprint(episode.steps[${moment}])`}`,
    },
    {
      name: "Markdown",
      text: () => `[${markdownText(episode.task.instruction)}](${location.href}) by ${markdownText(episode.header.policy.name)}: ${outcome}.${markdownText(why)}`,
    },
  ];
}
