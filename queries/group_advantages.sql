-- group_advantages
--
-- Group-relative advantages of rollouts (paper, GSPO Objective): (J - mean) / (std + eps) over the episodes of a prompt
-- group. Episodes without an end are left out. Branches count as in `groups`.
--
-- Columns:
--   group_id, rollout_index  the prompt group, and which of its rollouts
--   policy, task_id, success, total_reward  the episode
--   discounted_return  J, discounted by 0.99 a step
--   advantage  the group-relative advantage; std is the population's
--   episode_id, trace  the episode
--
-- Parameters:
--   $eps = 0.000001  keeps groups of equal returns from dividing by nothing
--
-- Example: reel query --store store --named group_advantages --param eps=0.0001
WITH grouped AS (
  SELECT
    array_agg(episode_id ORDER BY rollout_index, episode_id) AS members,
    advantages(array_agg(discounted_return ORDER BY rollout_index, episode_id), CAST($eps AS DOUBLE)) AS relative
  FROM episodes e
  WHERE group_id IS NOT NULL AND end_reason IS NOT NULL
    AND NOT EXISTS (SELECT 1 FROM episodes p WHERE p.trace_digest = e.parent_trace AND p.group_id = e.group_id)
  GROUP BY group_id
),
flat AS (
  SELECT unnest(members) AS episode_id, unnest(relative) AS advantage FROM grouped
)
SELECT
  e.group_id, e.rollout_index, e.policy, e.task_id, e.success, e.total_reward, e.discounted_return,
  f.advantage, e.episode_id, e.trace
FROM flat f
JOIN episodes e ON e.episode_id = f.episode_id
ORDER BY e.group_id, e.rollout_index, e.episode_id
