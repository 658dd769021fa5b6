-- answer_fidelity
--
-- How faithful the answers of simulated and real users are, by the people who labelled them (`reel store label answer`; the
-- paper labels 50 answers: 47 faithful, 2 unclear, 1 unfaithful).
--
-- Columns:
--   source       who answered: rule-based, model, human
--   answers      answers to questions
--   refused      replies of a model that gave something away, so that it was asked again
--   labelled     answers that somebody labelled
--   faithful     labelled so by all authors: right, and enough to go on
--   unclear      not enough to tell
--   unfaithful   wrong
--   disputed     authors disagree
--   share        faithful ones of those that are not disputed
--   low, high    Wilson's 95 % interval of it
--
-- Example: reel query --store store --named answer_fidelity
WITH said AS (
  SELECT episode_id, step, min(label) AS label, count(DISTINCT label) AS opinions
  FROM answer_labels
  GROUP BY episode_id, step
)
SELECT
  s.reply_source AS source,
  count(*) AS answers,
  sum(s.refused_replies) AS refused,
  count(l.label) AS labelled,
  count(*) FILTER (WHERE l.opinions = 1 AND l.label = 'faithful') AS faithful,
  count(*) FILTER (WHERE l.opinions = 1 AND l.label = 'unclear') AS unclear,
  count(*) FILTER (WHERE l.opinions = 1 AND l.label = 'unfaithful') AS unfaithful,
  count(*) FILTER (WHERE l.opinions > 1) AS disputed,
  avg(CAST(l.label = 'faithful' AS DOUBLE)) FILTER (WHERE l.opinions = 1) AS share,
  wilson_low(count(*) FILTER (WHERE l.opinions = 1 AND l.label = 'faithful'), count(*) FILTER (WHERE l.opinions = 1)) AS low,
  wilson_high(count(*) FILTER (WHERE l.opinions = 1 AND l.label = 'faithful'), count(*) FILTER (WHERE l.opinions = 1)) AS high
FROM steps s
LEFT JOIN said l ON l.episode_id = s.episode_id AND l.step = s.step
WHERE s.tool = 'ask' AND s.error_code IS NULL AND s.reply IS NOT NULL AND s.parent_trace IS NULL
GROUP BY s.reply_source
ORDER BY s.reply_source
