-- longest_episodes
--
-- The episodes of each policy with the most decisions; of equally long ones those first over which it took longest.
--
-- Columns:
--   policy, family, task_id, success, end_reason  the episode; without an end the trace breaks off
--   decisions    how many
--   failed       of them with an error
--   latency_s    time that the policy took, seconds; null: not told
--   simulated_s  simulated time, seconds
--   driven_m     path that the base drove, metres
--   episode_id, trace  the episode
--
-- Parameters:
--   $top = 5  how many of each policy
--
-- Example: reel query --store store --named longest_episodes --param top=20
WITH spent AS (
  SELECT
    episode_id, count(*) AS decisions, count(error_code) AS failed,
    sum(latency_ns) / 1e9 AS latency_s, max(sim_step) / 240.0 AS simulated_s
  FROM steps
  WHERE parent_trace IS NULL
  GROUP BY episode_id
),
ranked AS (
  SELECT
    e.policy, e.family, e.task_id, e.success, e.end_reason,
    s.decisions, s.failed, s.latency_s, s.simulated_s, e.path_length_m AS driven_m, e.episode_id, e.trace,
    row_number() OVER (
      PARTITION BY e.policy ORDER BY s.decisions DESC, s.latency_s DESC NULLS LAST, e.family, e.task_id, e.episode_id
    ) AS place
  FROM episodes e
  JOIN spent s ON s.episode_id = e.episode_id
)
SELECT
  policy, family, task_id, success, end_reason, decisions, failed, latency_s, simulated_s, driven_m, episode_id, trace
FROM ranked
WHERE place <= CAST($top AS BIGINT)
ORDER BY policy, place
