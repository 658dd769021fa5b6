-- latency
--
-- How long policies take to decide, and how much they read and write; over the decisions that tell of it.
--
-- Columns:
--   policy     who decided
--   decisions  how many tell how long they took
--   mean_s, p50_s, p90_s, p99_s, max_s  seconds a decision: mean, time within which half of them,
--              90 % and 99 % are made, greatest
--   episode_s  mean seconds an episode
--   prompt_tokens, completion_tokens  mean a decision, where it is known
--
-- Example: reel query --store store --named latency
WITH timed AS (
  SELECT
    policy, episode_id, prompt_tokens, completion_tokens, latency_ns / 1e9 AS latency_s,
    (1.0 * row_number() OVER (PARTITION BY policy ORDER BY latency_ns)) / count(*) OVER (PARTITION BY policy) AS part
  FROM steps
  WHERE latency_ns IS NOT NULL AND parent_trace IS NULL
)
SELECT
  policy,
  count(*) AS decisions,
  avg(latency_s) AS mean_s,
  min(latency_s) FILTER (WHERE part >= 0.5) AS p50_s,
  min(latency_s) FILTER (WHERE part >= 0.9) AS p90_s,
  min(latency_s) FILTER (WHERE part >= 0.99) AS p99_s,
  max(latency_s) AS max_s,
  sum(latency_s) / count(DISTINCT episode_id) AS episode_s,
  avg(prompt_tokens) AS prompt_tokens,
  avg(completion_tokens) AS completion_tokens
FROM timed
GROUP BY policy
ORDER BY policy
