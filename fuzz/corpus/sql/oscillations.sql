WITH runs AS (
  SELECT oscillation(steps) AS run, policy, family, task_id, success, episode_id, trace FROM episodes
)
SELECT
  run['length'] AS length, run['first'] AS first_step, run['one'] AS one, run['other'] AS other,
  policy, family, task_id, success, episode_id, trace
FROM runs
WHERE run IS NOT NULL
ORDER BY length DESC, policy, task_id, episode_id