-- execution
--
-- How long robots and servers take to carry calls out, and the model beneath the tools to decide; over the calls that tell
-- of it. How long the policy itself takes is in `latency`.
--
-- Columns:
--   policy         who decided
--   tool           the tool
--   calls          how many tell
--   failed         of them with an error
--   mean_s, max_s  seconds a call
--   inferences     mean a call of the model beneath, where there were some
--   inference_ms   mean milliseconds of one
--   control_steps  mean a call of the low-level controller, where it is known
--
-- Example: reel query --store store --named execution
WITH inferences AS (
  SELECT episode_id, step, count(*) AS inferences, sum(duration_ns) AS sum_ns
  FROM measurements WHERE kind = 'vla' GROUP BY episode_id, step
),
primitives_run AS (
  SELECT episode_id, step, sum(duration_ns) AS duration_ns, sum(control_steps) AS control_steps
  FROM measurements WHERE kind = 'primitive' GROUP BY episode_id, step
),
timed AS (
  SELECT
    s.policy, s.tool, s.error_code, coalesce(s.duration_ns, p.duration_ns) / 1e9 AS took_s, i.inferences, i.sum_ns, p.control_steps
  FROM steps s
  LEFT JOIN inferences i ON i.episode_id = s.episode_id AND i.step = s.step
  LEFT JOIN primitives_run p ON p.episode_id = s.episode_id AND p.step = s.step
  WHERE s.parent_trace IS NULL
)
SELECT
  policy,
  tool,
  count(*) AS calls,
  count(error_code) AS failed,
  avg(took_s) AS mean_s,
  max(took_s) AS max_s,
  avg(inferences) AS inferences,
  sum(sum_ns) / 1e6 / sum(inferences) AS inference_ms,
  avg(control_steps) AS control_steps
FROM timed
WHERE took_s IS NOT NULL OR inferences IS NOT NULL OR control_steps IS NOT NULL
GROUP BY policy, tool
ORDER BY policy, tool
