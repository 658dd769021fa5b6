-- reward_components
--
-- Where the reward comes from: mean of each component an episode, by policy. Episodes whose trace breaks off are left out.
--
-- Columns:
--   policy     who decided
--   preset     reward preset
--   component  task, prog, phys, ask, time, safe
--   mean       sum of the component an episode, mean over all the policy's episodes
--   low, high  the smallest and the greatest single term
--   terms      how many terms that are not zero
--
-- Example: reel query --store store --named reward_components
WITH played AS (
  SELECT policy, preset, count(*) AS episodes
  FROM episodes
  WHERE end_reason IS NOT NULL AND parent_trace IS NULL
  GROUP BY policy, preset
),
terms AS (
  SELECT e.policy, e.preset, r.component, r.value
  FROM rewards r
  JOIN episodes e ON e.episode_id = r.episode_id AND r.version IS NULL
  WHERE e.end_reason IS NOT NULL AND e.parent_trace IS NULL
)
SELECT
  t.policy, t.preset, t.component,
  sum(t.value) / min(p.episodes) AS mean,
  min(t.value) AS low,
  max(t.value) AS high,
  count(*) AS terms
FROM terms t
JOIN played p ON p.policy = t.policy AND p.preset = t.preset
GROUP BY t.policy, t.preset, t.component
ORDER BY t.policy, t.preset, t.component
