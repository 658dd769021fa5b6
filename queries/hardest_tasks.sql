-- hardest_tasks
--
-- Tasks by how often they are solved, the hardest first.
--
-- Columns:
--   family, task_id  the task
--   policies     how many played it
--   solved_by    how many of them solved it at least once
--   episodes     how many were played to an end
--   success      SR
--   completion   CR
--   length       mean number of decisions
--   failure      the most frequent class of its failures (see `failed_episodes`), the first by name of equals
--   instruction  what the agent was told
--
-- Example: reel query --store store --named hardest_tasks
WITH counts AS (
  SELECT e.task_digest, f.class, count(*) AS failures
  FROM failed_episodes f
  JOIN episodes e ON e.episode_id = f.episode_id
  GROUP BY e.task_digest, f.class
),
usual AS (
  SELECT task_digest, first_value(class ORDER BY failures DESC, class) AS failure FROM counts GROUP BY task_digest
)
SELECT
  e.family, e.task_id,
  count(DISTINCT e.policy) AS policies,
  count(DISTINCT CASE WHEN e.success THEN e.policy END) AS solved_by,
  count(*) AS episodes,
  avg(CAST(e.success AS DOUBLE)) AS success,
  avg(e.completion) AS completion,
  avg(e.length) AS length,
  min(c.failure) AS failure,
  min(e.instruction) AS instruction
FROM episodes e
LEFT JOIN usual c ON c.task_digest = e.task_digest
WHERE e.success IS NOT NULL AND e.parent_trace IS NULL
GROUP BY e.family, e.task_id, e.task_digest
ORDER BY success, round(avg(e.completion), 6), e.family, e.task_id, e.task_digest
