-- questions
--
-- Every question that reached the user, with what came of it. Malformed calls of `ask` are in `errors`.
--
-- Columns:
--   policy, family, task_id, success  the episode
--   step             the decision
--   candidate_count  objects that may be taken for the target, seen so far
--   useful           whether there was something to ask: several candidates had been seen, or the reward preset `paper` gave
--                    a reward for the question
--   question         what was asked
--   reply            what the user answered; null: nothing
--   source           who answered: rule-based, model, human
--   words            words of the answer
--   next_pick        what the next pick that worked took: `right` (an object that the goal moves), `wrong`; null: there was none
--   episode_id, trace  the episode
--
-- Example: reel query --store store "SELECT question, reply FROM questions WHERE next_pick = 'wrong'"
WITH calls AS (
  SELECT episode_id, step, candidate_count, question, reply, reply_source
  FROM steps
  WHERE tool = 'ask' AND error_code IS NULL AND parent_trace IS NULL
),
picks AS (
  SELECT q.episode_id, q.step, first_value(s.goal_object ORDER BY s.step) AS right_one
  FROM calls q
  JOIN steps s ON s.episode_id = q.episode_id AND s.step > q.step AND s.tool = 'pick' AND s.error_code IS NULL
  GROUP BY q.episode_id, q.step
),
earned AS (
  SELECT DISTINCT episode_id, step
  FROM rewards
  WHERE version IS NULL AND preset = 'paper' AND component = 'ask' AND value > 0
)
SELECT
  e.policy, e.family, e.task_id, e.success, q.step, q.candidate_count,
  q.candidate_count > 1 OR r.step IS NOT NULL AS useful,
  q.question, q.reply, q.reply_source AS source,
  CASE WHEN q.reply IS NOT NULL THEN regexp_count(q.reply, '\S+') END AS words,
  CASE WHEN p.right_one THEN 'right' WHEN NOT p.right_one THEN 'wrong' END AS next_pick,
  e.episode_id, e.trace
FROM calls q
JOIN episodes e ON e.episode_id = q.episode_id
LEFT JOIN picks p ON p.episode_id = q.episode_id AND p.step = q.step
LEFT JOIN earned r ON r.episode_id = q.episode_id AND r.step = q.step
ORDER BY e.policy, e.family, e.task_id, e.episode_id, q.step
