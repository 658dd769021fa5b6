-- success_by_budget
--
-- What a smaller budget would cost: share of the episodes that succeed within so many decisions.
--
-- Columns:
--   policy     who decided
--   decisions  the budget; a row for each number of decisions with which an episode succeeds
--   successes  episodes that succeed within it
--   success    their share of the policy's episodes with an end
--
-- Example: reel query --store store --named success_by_budget
WITH played AS (
  SELECT policy, count(*) AS episodes FROM episodes WHERE success IS NOT NULL AND parent_trace IS NULL GROUP BY policy
),
lengths AS (
  SELECT policy, length, count(*) AS successes FROM episodes WHERE success AND parent_trace IS NULL GROUP BY policy, length
),
sums AS (
  SELECT policy, length, sum(successes) OVER (PARTITION BY policy ORDER BY length) AS successes FROM lengths
)
SELECT s.policy, s.length AS decisions, s.successes, 1.0 * s.successes / p.episodes AS success
FROM sums s
JOIN played p ON p.policy = s.policy
ORDER BY s.policy, decisions
