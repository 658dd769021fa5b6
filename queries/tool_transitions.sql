-- tool_transitions
--
-- What follows what: each tool and the call after it.
--
-- Columns:
--   policy  who decided
--   tool    what was called; `(start)`: nothing yet
--   next    what was called next; `(end)`: nothing any more
--   calls   how many
--   share   of the policy's calls of that tool
--
-- Example: reel query --store store "SELECT * FROM tool_transitions WHERE tool = 'place'"
WITH sequences AS (
  SELECT policy, array_concat(['(start)'], step_texts(steps, 'tool'), ['(end)']) AS tools
  FROM episodes
  WHERE parent_trace IS NULL
),
pairs AS (
  SELECT policy, unnest(array_pop_back(tools)) AS tool, unnest(array_pop_front(tools)) AS next FROM sequences
),
counts AS (
  SELECT policy, tool, next, count(*) AS calls FROM pairs GROUP BY policy, tool, next
)
SELECT policy, tool, next, calls, 1.0 * calls / sum(calls) OVER (PARTITION BY policy, tool) AS share
FROM counts
ORDER BY policy, tool, calls DESC, next
