-- policy_comparison
--
-- Every two policies on the tasks that both played. The unit is the task: its success is the mean over its episodes, and
-- it counts as solved where more than half of them succeed.
--
-- Columns:
--   a, b        the two policies
--   tasks       tasks that both played to an end
--   success_a, success_b  mean success over these tasks
--   only_a, only_b  tasks that only one of them solved
--   p           McNemar's exact test of these two numbers, two-sided; not corrected for the number of pairs
--   difference  success_a - success_b
--   low, high   its 95 % interval: percentiles of 2,000 resamplings of the tasks, seed 7
--
-- Example: reel query --store store "SELECT * FROM policy_comparison WHERE p < 0.05"
WITH solved AS (
  SELECT policy, task_digest, avg(CAST(success AS DOUBLE)) AS success
  FROM episodes
  WHERE success IS NOT NULL AND parent_trace IS NULL
  GROUP BY policy, task_digest
),
pairs AS (
  SELECT
    a.policy AS a, b.policy AS b,
    count(*) AS tasks,
    avg(a.success) AS success_a,
    avg(b.success) AS success_b,
    count(*) FILTER (WHERE a.success > 0.5 AND b.success <= 0.5) AS only_a,
    count(*) FILTER (WHERE b.success > 0.5 AND a.success <= 0.5) AS only_b,
    paired_bootstrap(
      array_agg(a.success ORDER BY a.task_digest), array_agg(b.success ORDER BY a.task_digest), 2000, 7
    ) AS bootstrap
  FROM solved a
  JOIN solved b ON b.task_digest = a.task_digest AND b.policy > a.policy
  GROUP BY a.policy, b.policy
)
SELECT
  a, b, tasks, success_a, success_b, only_a, only_b,
  mcnemar(only_a, only_b) AS p,
  bootstrap['difference'] AS difference, bootstrap['low'] AS low, bootstrap['high'] AS high
FROM pairs
ORDER BY a, b
