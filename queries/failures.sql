-- failures
--
-- Failures by class, as in the paper's failure analysis; `failed_episodes` has each episode's evidence.
--
-- Columns:
--   policy     who decided
--   class      Object Confusion, Key Action Missing, Lost Memory, Other; `not classified`: run `reel taxonomy`
--   sub_class  what within that class
--   episodes   how many
--   share      of the policy's failures
--   example    one of them: a trace to look at
--
-- Example: reel query --store store --named failures
WITH counts AS (
  SELECT policy, class, sub_class, count(*) AS episodes, min(trace) AS example
  FROM failed_episodes
  GROUP BY policy, class, sub_class
)
SELECT
  policy, class, sub_class, episodes,
  1.0 * episodes / sum(episodes) OVER (PARTITION BY policy) AS share,
  example
FROM counts
ORDER BY policy, episodes DESC, class, sub_class
