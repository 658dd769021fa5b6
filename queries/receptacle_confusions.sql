-- receptacle_confusions
--
-- Which furniture is taken for which: places of a goal object elsewhere than where the goal wants it.
--
-- Columns:
--   policy     who decided
--   scene_id   where
--   wanted     the destination
--   placed_on  where the object was placed instead
--   alike      whether the task names that as furniture like the destination
--   source     whether that is where the object came from: it was put back
--   places     how many such calls
--   episodes   in how many episodes
--   successes  how many of these succeeded nevertheless
--   example    one of them: a trace to look at
--
-- Example: reel query --store store --named receptacle_confusions
SELECT
  e.policy, e.scene_id,
  e.dest AS wanted, s.receptacle AS placed_on,
  array_has(t.dest_distractors, s.receptacle) AS alike,
  s.receptacle = e.src AS source,
  count(*) AS places,
  count(DISTINCT e.episode_id) AS episodes,
  count(DISTINCT CASE WHEN e.success THEN e.episode_id END) AS successes,
  min(e.trace) AS example
FROM steps s
JOIN episodes e ON e.episode_id = s.episode_id
JOIN tasks t ON t.task_digest = e.task_digest
WHERE s.tool = 'place' AND s.error_code IS NULL AND s.goal_object AND NOT s.goal_receptacle AND e.parent_trace IS NULL
GROUP BY e.policy, e.scene_id, e.dest, s.receptacle, alike, source
ORDER BY places DESC, e.policy, e.scene_id, wanted, placed_on, alike, source
