-- object_confusions
--
-- Which objects are taken for which: picks of an object that the goal does not move, by what was wanted.
--
-- Columns:
--   policy     who decided
--   wanted, wanted_caption  category and caption of the target
--   picked, picked_caption  category and caption of the object that was picked instead; null: the task does not tell
--   alike      whether both are of one category
--   picks      how many such picks
--   episodes   in how many episodes
--   successes  how many of these succeeded nevertheless
--   example    one of them: a trace to look at
--
-- Example: reel query --store store --named object_confusions
SELECT
  e.policy,
  e.target_category AS wanted, e.target_caption AS wanted_caption,
  o.category AS picked, o.caption AS picked_caption,
  o.category = e.target_category AS alike,
  count(*) AS picks,
  count(DISTINCT e.episode_id) AS episodes,
  count(DISTINCT CASE WHEN e.success THEN e.episode_id END) AS successes,
  min(e.trace) AS example
FROM steps s
JOIN episodes e ON e.episode_id = s.episode_id
LEFT JOIN objects o ON o.task_digest = e.task_digest AND o.instance = s.object
WHERE s.tool = 'pick' AND s.error_code IS NULL AND NOT s.goal_object AND e.parent_trace IS NULL
GROUP BY e.policy, e.target_category, e.target_caption, o.category, o.caption
ORDER BY picks DESC, e.policy, wanted, wanted_caption, picked, picked_caption
