-- failures
--
-- Failures by class, as in the paper's failure analysis; `failed_episodes` has the rules and each episode's evidence.
--
-- Columns:
--   policy    who decided
--   class     Object Confusion, Key Action Missing, Lost Memory, Other
--   cause     what within that class
--   episodes  how many
--   share     of the policy's failures
--   example   one of them: a trace to look at
--
-- Example: reel query --store store --named failures
WITH counts AS (
  SELECT policy, class, cause, count(*) AS episodes, min(trace) AS example
  FROM failed_episodes
  GROUP BY policy, class, cause
)
SELECT
  policy, class, cause, episodes,
  1.0 * episodes / sum(episodes) OVER (PARTITION BY policy) AS share,
  example
FROM counts
ORDER BY policy, episodes DESC, class, cause
