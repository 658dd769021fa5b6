-- episodes_matching
--
-- Episodes whose steps contain a pattern, and where. See `sequence_match` of `reel query --functions`.
--
-- Columns:
--   policy, family, task_id, success  the episode
--   first, last  decisions at which the first occurrence begins and ends
--   times        how often it occurs, without overlap
--   episode_id, trace  the episode
--
-- Parameters:
--   $pattern = pick[failed] .. pick[ok]  the pattern
--
-- Example: reel query --store store --named episodes_matching --param "pattern=^ !ask* pick"
WITH found AS (
  SELECT
    policy, family, task_id, success, episode_id, trace,
    sequence_find(steps, $pattern) AS found,
    sequence_count(steps, $pattern) AS times
  FROM episodes
  WHERE parent_trace IS NULL
)
SELECT policy, family, task_id, success, found['first'] AS first, found['last'] AS last, times, episode_id, trace
FROM found
WHERE found IS NOT NULL
ORDER BY policy, family, task_id, episode_id
