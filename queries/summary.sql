-- summary
--
-- A store in sentences, each with its numbers and up to three traces that show it: how many episodes succeeded and what they
-- left behind, the commonest kinds of failure, what could still have been saved, and where explanations are in doubt. Counts what
-- the tables hold and judges nothing. Percentages have Wilson's 95 % interval.
--
-- Columns:
--   number    their order
--   sentence  what there is to say
--   episodes  how many it holds for
--   of        of how many
--   traces    the shortest that show it
--
-- Example: reel query --store store --named summary
WITH judged AS (
  SELECT
    e.success, e.trace, e.length, e.episode_id, c.class, c.sub_class, c.cause, b.step AS decisive, b.repairable_at_end,
    array_length(c.conflicts) > 0 AS in_doubt,
    e.success AND sequence_match(
      e.steps, 'place[ok and not goal_object and put_back is not true] !place[put_back]* $'
    ) AS left_elsewhere
  FROM episodes e
  LEFT JOIN classes c ON c.episode_id = e.episode_id AND c.trace_digest = e.trace_digest
  LEFT JOIN blame b ON b.episode_id = e.episode_id AND b.trace_digest = e.trace_digest
  WHERE e.parent_trace IS NULL
),
kinds AS (
  SELECT
    class, sub_class, CASE WHEN count(DISTINCT cause) = 1 THEN min(cause) END AS only_cause, count(*) AS episodes,
    array_slice(array_agg(trace ORDER BY length, episode_id), 1, 3) AS traces
  FROM judged WHERE NOT success AND class IS NOT NULL
  GROUP BY class, sub_class
  ORDER BY episodes DESC, class, sub_class LIMIT 4
),
counts AS (
  SELECT
    count(*) FILTER (WHERE NOT success) AS failed,
    count(*) FILTER (WHERE NOT success AND class IS NOT NULL) AS classified,
    count(*) FILTER (WHERE success) AS succeeded,
    count(success) AS played,
    count(*) FILTER (WHERE left_elsewhere) AS left_elsewhere,
    count(*) FILTER (WHERE NOT success AND decisive IS NOT NULL) AS measured,
    count(*) FILTER (WHERE NOT success AND repairable_at_end) AS repairable,
    count(*) FILTER (WHERE in_doubt) AS in_doubt,
    array_slice(array_agg(trace ORDER BY length, episode_id) FILTER (WHERE success), 1, 3) AS successes,
    array_slice(array_agg(trace ORDER BY length, episode_id) FILTER (WHERE left_elsewhere), 1, 3) AS leaving,
    array_slice(array_agg(trace ORDER BY length, episode_id) FILTER (WHERE NOT success AND repairable_at_end), 1, 3) AS repairables,
    array_slice(array_agg(trace ORDER BY length, episode_id) FILTER (WHERE in_doubt), 1, 3) AS doubts,
    array_slice(array_agg(trace ORDER BY length, episode_id) FILTER (WHERE NOT success AND class IS NULL), 1, 3) AS unclassified
  FROM judged
),
statements AS (
  SELECT 1 AS part, 0 AS rank, 'episodes succeeded' AS what, succeeded AS episodes, played AS of, successes AS traces FROM counts
  UNION ALL
  SELECT 2, 0, 'successes left an object elsewhere that the goal does not move', left_elsewhere, succeeded, leaving FROM counts
  UNION ALL
  SELECT
    3, -episodes, 'classified failures are ' || replace(sub_class, '_', ' ') || ' (' || class || coalesce('; cause: ' || only_cause, '') || ')',
    episodes, (SELECT classified FROM counts), traces
  FROM kinds
  UNION ALL
  SELECT 4, 0, 'measured failures could still have been saved by a competent agent at the last call', repairable, measured, repairables FROM counts
  UNION ALL
  SELECT 5, 0, 'explanations are in doubt: rules and measurement disagree', in_doubt, classified, doubts FROM counts
  UNION ALL
  SELECT 6, 0, 'failures have no class yet: run reel taxonomy', failed - classified, failed, unclassified FROM counts
)
SELECT
  row_number() OVER (ORDER BY part, rank, what) AS number,
  concat(
    episodes, ' of ', of, ' ', what, ', ',
    CAST(round(100.0 * episodes / of) AS BIGINT), '% [', CAST(round(100 * wilson_low(episodes, of)) AS BIGINT), ', ',
    CAST(round(100 * wilson_high(episodes, of)) AS BIGINT), '].'
  ) AS sentence,
  episodes, of, coalesce(traces, make_array()) AS traces
FROM statements
WHERE of > 0 AND (part = 1 OR episodes > 0)
ORDER BY part, rank, what
