-- vocabulary_misses
--
-- Queries of `show_object_by_category` whose meaning nobody knows: words that Reel's word list lacks, where it decided, and
-- queries that mean no category by vectors. Of a branch its own calls count, not those that it repeats.
--
-- Columns:
--   query      the word or phrase, in lower case
--   source     what did not know it: `words`, or the embedding model or file of vectors
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
    lower(trim(s.argument)) AS query, s.match_source AS source, s.episode_id, s.step, s.error_code IS NOT NULL AS failed,
    e.policy, e.success, e.trace
  FROM steps s
  JOIN episodes e ON e.episode_id = s.episode_id
  WHERE
    (e.parent_call IS NULL OR s.step >= e.parent_call)
    AND (
      (s.match_source = 'words' AND NOT s.query_known)
      OR (s.match_source IS NOT NULL AND cardinality(s.match_categories) = 0)
    )
)
SELECT
  query,
  source,
  count(*) AS calls,
  count(*) FILTER (WHERE failed) AS failed,
  count(DISTINCT episode_id) AS episodes,
  count(DISTINCT policy) AS policies,
  count(DISTINCT CASE WHEN success THEN episode_id END) AS successes,
  min(trace) AS trace,
  first_value(step ORDER BY trace, step) AS step
FROM misses
GROUP BY query, source
ORDER BY calls DESC, query, source
