-- vocabulary_misses
--
-- Queries of `show_object_by_category` that Reel's word list does not know, where words and not vectors decided what they
-- mean: candidates for the word list, or a reason to match by an embedding model.
--
-- Columns:
--   query      the word or phrase, in lower case
--   calls      calls with it
--   failed     those that found nothing
--   episodes   episodes with such a call
--   policies   policies that made one
--   successes  episodes among them that succeeded
--   trace      a trace with such a call
--   step       the first such call in that trace
--
-- Example: reel query --store store --named vocabulary_misses
WITH misses AS (
  SELECT
    lower(trim(s.argument)) AS query, s.episode_id, s.step, s.error_code IS NOT NULL AS failed,
    e.policy, e.success, e.trace
  FROM steps s
  JOIN episodes e ON e.episode_id = s.episode_id
  WHERE s.match_source = 'words' AND NOT s.query_known
)
SELECT
  query,
  count(*) AS calls,
  count(*) FILTER (WHERE failed) AS failed,
  count(DISTINCT episode_id) AS episodes,
  count(DISTINCT policy) AS policies,
  count(DISTINCT CASE WHEN success THEN episode_id END) AS successes,
  min(trace) AS trace,
  first_value(step ORDER BY trace, step) AS step
FROM misses
GROUP BY query
ORDER BY calls DESC, query
