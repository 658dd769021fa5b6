-- error_classes
--
-- Which tools are called wrongly, and how badly: tool by class of error, and over all tools; `errors` has the codes.
--
-- Columns:
--   policy             who decided
--   tool               what was called; the name as called where it is no tool; `all`: every call
--   calls              how many
--   calls_per_episode  calls an episode, over all the policy's episodes
--   succeeded          without an error
--   moderate           with a moderate error
--   severe             with a severe error
--   failed             share of the calls with an error of either class
--
-- Example: reel query --store store --named error_classes
WITH played AS (
  SELECT policy, count(*) AS episodes FROM episodes WHERE parent_trace IS NULL GROUP BY policy
),
counts AS (
  SELECT
    policy, coalesce(tool, 'all') AS tool, tool IS NULL AS is_total,
    count(*) AS calls,
    count(*) FILTER (WHERE error_code IS NULL) AS succeeded,
    count(*) FILTER (WHERE error_class = 'moderate') AS moderate,
    count(*) FILTER (WHERE error_class = 'severe') AS severe
  FROM steps
  WHERE parent_trace IS NULL
  GROUP BY GROUPING SETS ((policy, tool), (policy))
)
SELECT
  c.policy, c.tool, c.calls, 1.0 * c.calls / p.episodes AS calls_per_episode,
  c.succeeded, c.moderate, c.severe, 1.0 * (c.calls - c.succeeded) / c.calls AS failed
FROM counts c
JOIN played p ON p.policy = c.policy
ORDER BY c.policy, c.is_total, c.tool
