-- regressions
--
-- Tasks that one policy solves and another does not, with a trace of either to look at. A task counts as solved where
-- more than half of its episodes succeed; `policy_comparison` says whether there are enough of them to mean something.
--
-- Columns:
--   a, b     policy that solves the task, and policy that does not
--   family, task_id  the task
--   success_a, success_b  mean success over its episodes
--   episodes_a, episodes_b  how many
--   trace_a  an episode of a that succeeds
--   trace_b  an episode of b that fails
--
-- Parameters:
--   $a = %  policy that solves the task, as in LIKE; %: any
--   $b = %  policy that does not
--
-- Example: reel query --store store --named regressions --param a=old --param b=new
WITH solved AS (
  SELECT
    policy, family, task_id, task_digest,
    avg(CAST(success AS DOUBLE)) AS success,
    count(*) AS episodes,
    min(trace) FILTER (WHERE success) AS success_trace,
    min(trace) FILTER (WHERE NOT success) AS failure_trace
  FROM episodes
  WHERE success IS NOT NULL AND parent_trace IS NULL
  GROUP BY policy, family, task_id, task_digest
)
SELECT
  a.policy AS a, b.policy AS b, a.family, a.task_id,
  a.success AS success_a, b.success AS success_b,
  a.episodes AS episodes_a, b.episodes AS episodes_b,
  a.success_trace AS trace_a, b.failure_trace AS trace_b
FROM solved a
JOIN solved b ON b.task_digest = a.task_digest AND a.success > 0.5 AND b.success <= 0.5
WHERE a.policy LIKE CAST($a AS VARCHAR) AND b.policy LIKE CAST($b AS VARCHAR)
ORDER BY a, b, a.family, a.task_id, a.task_digest
