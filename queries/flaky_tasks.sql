-- flaky_tasks
--
-- Tasks that one and the same policy solves sometimes and sometimes not.
--
-- Columns:
--   policy     who decided
--   family, task_id  the task
--   episodes   how many were played to an end
--   seeds      different seeds among them; one: nothing but the policy differs
--   successes  successful ones
--   success    the share of those
--   success_trace, failure_trace  one of each to compare
--
-- Example: reel query --store store --named flaky_tasks
SELECT
  policy, family, task_id,
  count(*) AS episodes,
  count(DISTINCT seed) AS seeds,
  count(*) FILTER (WHERE success) AS successes,
  avg(CAST(success AS DOUBLE)) AS success,
  min(trace) FILTER (WHERE success) AS success_trace,
  min(trace) FILTER (WHERE NOT success) AS failure_trace
FROM episodes
WHERE success IS NOT NULL AND parent_trace IS NULL
GROUP BY policy, family, task_id, task_digest
HAVING count(*) FILTER (WHERE success) BETWEEN 1 AND count(*) - 1
ORDER BY policy, family, task_id, task_digest
