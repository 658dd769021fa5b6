-- errors
--
-- Which calls fail, and why: error codes by policy and tool, the most frequent first.
--
-- Columns:
--   policy, tool  who called what
--   error, class  why it failed, and how bad that is
--   calls         how many
--   share         of that policy's calls of that tool
--
-- Example: reel query --store store --named errors
WITH counts AS (
  SELECT policy, tool, error_code, error_class, count(*) AS calls
  FROM steps
  WHERE parent_trace IS NULL
  GROUP BY policy, tool, error_code, error_class
),
shares AS (
  SELECT *, 1.0 * calls / sum(calls) OVER (PARTITION BY policy, tool) AS share FROM counts
)
SELECT policy, tool, error_code AS error, error_class AS class, calls, share
FROM shares
WHERE error_code IS NOT NULL
ORDER BY calls DESC, policy, tool, error
