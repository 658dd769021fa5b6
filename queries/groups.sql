-- groups
--
-- Prompt groups of rollouts: whether there is anything to learn from them. Groups in which all returns are equal have
-- advantages of zero. Branches count where all rollouts of a group begin at a recorded call; a branch of one of the rollouts does not.
--
-- Columns:
--   group_id   the prompt group
--   policy, task_id  who played what (one of each, if it was several)
--   rollouts   episodes with an end
--   successes  successful ones
--   tasks      different tasks among them; more than one: the group is no group
--   mean, std  of the discounted returns; std of the population
--   worst, best  the smallest and the greatest
--   signal     whether the returns differ
--
-- Example: reel query --store store "SELECT count(*) FROM groups WHERE NOT signal"
SELECT
  group_id,
  min(policy) AS policy,
  min(task_id) AS task_id,
  count(*) AS rollouts,
  count(*) FILTER (WHERE success) AS successes,
  count(DISTINCT task_digest) AS tasks,
  avg(discounted_return) AS mean,
  stddev_pop(discounted_return) AS std,
  min(discounted_return) AS worst,
  max(discounted_return) AS best,
  max(discounted_return) > min(discounted_return) AS signal
FROM episodes e
WHERE group_id IS NOT NULL AND end_reason IS NOT NULL
  AND NOT EXISTS (SELECT 1 FROM episodes p WHERE p.trace_digest = e.parent_trace AND p.group_id = e.group_id)
GROUP BY group_id
ORDER BY group_id
