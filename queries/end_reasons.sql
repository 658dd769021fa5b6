-- end_reasons
--
-- How episodes end: by `finish`, at the horizon, by a fault, or not at all.
--
-- Columns:
--   policy      who decided
--   reason      finished, horizon, fault, aborted; `broken off`: the trace has no end
--   episodes    how many
--   share       of the policy's episodes
--   success     SR among them; null where the trace breaks off, like the next two
--   completion  CR among them
--   length      mean number of decisions
--
-- Example: reel query --store store --named end_reasons
WITH counts AS (
  SELECT
    policy, coalesce(end_reason, 'broken off') AS reason, count(*) AS episodes,
    avg(CAST(success AS DOUBLE)) AS success, avg(completion) AS completion, avg(length) AS length
  FROM episodes
  WHERE parent_trace IS NULL
  GROUP BY policy, end_reason
)
SELECT
  policy, reason, episodes,
  1.0 * episodes / sum(episodes) OVER (PARTITION BY policy) AS share,
  success, completion, length
FROM counts
ORDER BY policy, episodes DESC, reason
