-- effort
--
-- What decisions are spent on: shares of looking, moving, handling and asking, and of those that bring nothing.
--
-- Columns:
--   policy     who decided
--   success    whether the episodes succeed; null: the trace breaks off
--   episodes   how many
--   decisions  all together
--   moving     share of nav_to
--   looking    share of walk_around, show_object_by_category, show_receptacles and gaze_at
--   handling   share of pick, place, open and close
--   asking     share of ask
--   failed     share with an error
--   repeated   share that call the same tool with the same arguments as the decision before
--
-- Example: reel query --store store --named effort
WITH counts AS (
  SELECT
    policy, success,
    cardinality(steps) AS decisions,
    sequence_count(steps, 'nav_to') AS moving,
    sequence_count(steps, 'walk_around | show_object_by_category | show_receptacles | gaze_at') AS looking,
    sequence_count(steps, 'pick | place | open | close') AS handling,
    sequence_count(steps, 'ask') AS asking,
    sequence_count(steps, '_[failed]') AS failed,
    sequence_count(steps, '_[tool = tool@-1 and arguments = arguments@-1]') AS repeated
  FROM episodes
  WHERE parent_trace IS NULL
)
SELECT
  policy, success,
  count(*) AS episodes,
  sum(decisions) AS decisions,
  1.0 * sum(moving) / nullif(sum(decisions), 0) AS moving,
  1.0 * sum(looking) / nullif(sum(decisions), 0) AS looking,
  1.0 * sum(handling) / nullif(sum(decisions), 0) AS handling,
  1.0 * sum(asking) / nullif(sum(decisions), 0) AS asking,
  1.0 * sum(failed) / nullif(sum(decisions), 0) AS failed,
  1.0 * sum(repeated) / nullif(sum(decisions), 0) AS repeated
FROM counts
GROUP BY policy, success
ORDER BY policy, success
