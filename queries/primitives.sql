-- primitives
--
-- The paper's table of primitive executability: how often a call that moves an object or a door does so, by skill.
-- A call that goes wrong for want of a marker map or of a valid marker counts as a call of `place ?`, `pick` and so on;
-- on a robot whose furniture is not known, the kind is what the robot calls its target.
--
-- Columns:
--   policy     who decided
--   skill      open, close, pick, and `place` with the kind of furniture it aimed at; `all`: the four tools together
--   calls      how many
--   succeeded  of them without an error
--   success    the share of those
--   low, high  Wilson's 95 % interval of it
--
-- Parameters:
--   $backend = %  sim, robot or proxy, as in LIKE; %: any
--
-- Example: reel query --store store --named primitives --param backend=robot
WITH furniture AS (
  SELECT scene_digest, r['receptacle'] AS receptacle, r['category'] AS category
  FROM (SELECT scene_digest, unnest(receptacles) AS r FROM scenes)
),
named AS (
  SELECT episode_id, step, max(target) AS target FROM measurements WHERE kind = 'primitive' GROUP BY episode_id, step
),
-- a call that fails acted on nothing; the marker tells what it aimed at
aims AS (
  SELECT s.policy, s.tool, s.error_code, e.scene_digest, coalesce(s.receptacle, m.id) AS receptacle, n.target
  FROM steps s
  JOIN episodes e ON e.episode_id = s.episode_id AND e.backend LIKE CAST($backend AS VARCHAR)
  LEFT JOIN named n ON n.episode_id = s.episode_id AND n.step = s.step
  LEFT JOIN markers m ON m.episode_id = s.episode_id AND m.step = s.step AND CAST(m.marker AS VARCHAR) = s.argument
  WHERE s.tool IN ('open', 'close', 'pick', 'place') AND s.parent_trace IS NULL
),
calls AS (
  SELECT
    a.policy, a.error_code,
    CASE a.tool WHEN 'place' THEN concat('place ', coalesce(f.category, a.target, '?')) ELSE a.tool END AS skill
  FROM aims a
  LEFT JOIN furniture f ON f.scene_digest = a.scene_digest AND f.receptacle = a.receptacle
)
SELECT
  policy,
  coalesce(skill, 'all') AS skill,
  count(*) AS calls,
  count(*) FILTER (WHERE error_code IS NULL) AS succeeded,
  1.0 * count(*) FILTER (WHERE error_code IS NULL) / count(*) AS success,
  wilson_low(count(*) FILTER (WHERE error_code IS NULL), count(*)) AS low,
  wilson_high(count(*) FILTER (WHERE error_code IS NULL), count(*)) AS high
FROM calls
GROUP BY GROUPING SETS ((policy, skill), (policy))
ORDER BY policy, CASE skill WHEN 'all' THEN 1 ELSE 0 END, skill
