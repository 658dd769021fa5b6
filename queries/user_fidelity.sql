-- user_fidelity
--
-- Whether simulated users are as good as people: answers and what came of them, by who answered. What an answer was
-- worth is judged by the next pick; the paper has people judge it.
--
-- Columns:
--   policy       who decided
--   source       who answered: rule-based, model, human
--   answers      how many
--   words        mean number of words of an answer
--   led_right    answers after which the next pick took an object that the goal moves
--   led_wrong    answers after which it took another one
--   led_nowhere  answers with no pick after them
--   episodes     episodes with such an answer, played to an end
--   tasks        different tasks among them
--   successes    successful ones of these episodes
--   success      the share of those
--   low, high    Wilson's 95 % interval of it
--
-- Example: reel query --store store --named user_fidelity
WITH answers AS (
  SELECT
    episode_id, source, count(*) AS answers, sum(words) AS words,
    count(*) FILTER (WHERE next_pick = 'right') AS led_right,
    count(*) FILTER (WHERE next_pick = 'wrong') AS led_wrong,
    count(*) FILTER (WHERE next_pick IS NULL) AS led_nowhere
  FROM questions
  WHERE reply IS NOT NULL
  GROUP BY episode_id, source
)
SELECT
  e.policy, a.source,
  sum(a.answers) AS answers,
  1.0 * sum(a.words) / sum(a.answers) AS words,
  sum(a.led_right) AS led_right,
  sum(a.led_wrong) AS led_wrong,
  sum(a.led_nowhere) AS led_nowhere,
  count(e.end_reason) AS episodes,
  count(DISTINCT e.task_digest) FILTER (WHERE e.end_reason IS NOT NULL) AS tasks,
  count(*) FILTER (WHERE e.success) AS successes,
  avg(CAST(e.success AS DOUBLE)) AS success,
  wilson_low(count(*) FILTER (WHERE e.success), count(e.end_reason)) AS low,
  wilson_high(count(*) FILTER (WHERE e.success), count(e.end_reason)) AS high
FROM answers a
JOIN episodes e ON e.episode_id = a.episode_id
WHERE e.parent_trace IS NULL
GROUP BY e.policy, a.source
ORDER BY e.policy, a.source
