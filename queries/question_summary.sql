-- question_summary
--
-- What questions cost and bring, by policy, where the instruction is fuzzy and where it is not.
--
-- Columns:
--   policy        who decided
--   fuzzy         whether the agent was told less than the precise instruction
--   episodes      how many were played to an end
--   asks          mean number of questions
--   asked         share of the episodes with a question
--   useful        share of the questions that had something to ask (see `questions`)
--   answered      share of the questions with an answer
--   picked_right  share of the questions after which the next pick took an object that the goal moves, of those with a
--                 pick after them
--   success_asked, success_unasked  SR of the episodes with a question and of those without; they differ in tasks as well
--
-- Example: reel query --store store --named question_summary
WITH of_episode AS (
  SELECT
    episode_id, count(*) AS asks, count(*) FILTER (WHERE useful) AS useful, count(reply) AS answered,
    count(next_pick) AS picked, count(*) FILTER (WHERE next_pick = 'right') AS picked_right
  FROM questions
  GROUP BY episode_id
)
SELECT
  e.policy, e.fuzzy,
  count(*) AS episodes,
  1.0 * coalesce(sum(q.asks), 0) / count(*) AS asks,
  1.0 * count(q.asks) / count(*) AS asked,
  1.0 * sum(q.useful) / sum(q.asks) AS useful,
  1.0 * sum(q.answered) / sum(q.asks) AS answered,
  1.0 * sum(q.picked_right) / nullif(sum(q.picked), 0) AS picked_right,
  avg(CAST(e.success AS DOUBLE)) FILTER (WHERE q.asks IS NOT NULL) AS success_asked,
  avg(CAST(e.success AS DOUBLE)) FILTER (WHERE q.asks IS NULL) AS success_unasked
FROM episodes e
LEFT JOIN of_episode q ON q.episode_id = e.episode_id
WHERE e.end_reason IS NOT NULL AND e.parent_trace IS NULL
GROUP BY e.policy, e.fuzzy
ORDER BY e.policy, e.fuzzy
