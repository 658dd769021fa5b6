-- rescored_rewards
--
-- What another reward preset, or another version of one, makes of the same episodes: rewards as recorded and as
-- recomputed by `reel store reward`.
--
-- Columns:
--   policy    who decided
--   recorded  preset under which the episodes were recorded
--   preset, version  preset under which they were scored again, and the digest of its content
--   episodes  how many were played to an end
--   reward_recorded, reward  mean cumulative reward, as recorded and as recomputed
--   difference  mean of reward - reward_recorded
--   higher, lower  episodes that have more now, and less
--   least, most  the smallest and the greatest difference
--
-- Example: reel query --store store --named rescored_rewards
WITH scored AS (
  SELECT
    e.policy, e.preset AS recorded, r.preset, r.version, e.total_reward AS reward_recorded, r.total_reward AS reward,
    r.total_reward - e.total_reward AS difference
  FROM rescored r
  JOIN episodes e ON e.episode_id = r.episode_id AND e.trace_digest = r.trace_digest
  WHERE e.end_reason IS NOT NULL AND e.parent_trace IS NULL
)
SELECT
  policy, recorded, preset, version,
  count(*) AS episodes,
  avg(reward_recorded) AS reward_recorded,
  avg(reward) AS reward,
  avg(difference) AS difference,
  count(*) FILTER (WHERE difference > 0) AS higher,
  count(*) FILTER (WHERE difference < 0) AS lower,
  min(difference) AS least,
  max(difference) AS most
FROM scored
GROUP BY policy, recorded, preset, version
ORDER BY policy, recorded, preset, version
