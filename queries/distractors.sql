-- distractors
--
-- What distractors cost: success by how many objects there are that may be taken for the target.
--
-- Columns:
--   policy       who decided
--   distractors  placed objects that are the task's object distractors or of the target's category
--   episodes     how many were played to an end
--   tasks        different ones among them
--   success      SR
--   low, high    Wilson's 95 % interval of it
--   wrong_pick   share of the episodes in which an object was picked that the goal does not move
--   asks         mean number of questions
--   length       mean number of decisions
--
-- Example: reel query --store store --named distractors
WITH placed AS (
  SELECT task_digest, count(*) AS distractors FROM objects WHERE role = 'distractor' GROUP BY task_digest
),
played AS (
  SELECT
    e.policy, e.task_digest, e.success, e.asks, e.length, coalesce(p.distractors, 0) AS distractors,
    sequence_match(e.steps, 'pick[ok and not goal_object]') AS wrong_pick
  FROM episodes e
  LEFT JOIN placed p ON p.task_digest = e.task_digest
  WHERE e.success IS NOT NULL AND e.parent_trace IS NULL
)
SELECT
  policy, distractors,
  count(*) AS episodes,
  count(DISTINCT task_digest) AS tasks,
  avg(CAST(success AS DOUBLE)) AS success,
  wilson_low(count(*) FILTER (WHERE success), count(*)) AS low,
  wilson_high(count(*) FILTER (WHERE success), count(*)) AS high,
  avg(CAST(wrong_pick AS DOUBLE)) AS wrong_pick,
  avg(asks) AS asks,
  avg(length) AS length
FROM played
GROUP BY policy, distractors
ORDER BY policy, distractors
