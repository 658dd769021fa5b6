-- What the answers are made of, over the Delta tables as they are.

-- A letter a call: upper case where it fails; q and m are a pick and a place of an object that the goal does not move.
CREATE MACRO letter(call) AS (
  CASE
    WHEN call.error_code IS NOT NULL THEN upper(kind(call.tool))
    WHEN call.tool = 'pick' AND NOT call.goal_object THEN 'q'
    WHEN call.tool = 'place' AND NOT call.goal_object THEN 'm'
    ELSE kind(call.tool)
  END
);
CREATE MACRO kind(tool) AS (
  CASE tool
    WHEN 'nav_to' THEN 'n' WHEN 'walk_around' THEN 'w' WHEN 'gaze_at' THEN 'g'
    WHEN 'show_object_by_category' THEN 's' WHEN 'show_receptacles' THEN 'r'
    WHEN 'pick' THEN 'p' WHEN 'place' THEN 'l' WHEN 'open' THEN 'o' WHEN 'close' THEN 'c' WHEN 'ask' THEN 'a' ELSE 'z'
  END
);
-- The episodes without the branches, each with its calls as one word.
CREATE VIEW told AS SELECT *, ifnull(array_to_string([letter(call) FOR call IN steps], ''), '') AS word
FROM episodes WHERE parent_trace IS NULL;
-- Members of prompt groups: not what branches from a member.
CREATE VIEW grouped AS
FROM episodes WHERE end_reason IS NOT NULL AND group_id IS NOT NULL
AND (parent_trace IS NULL OR (parent_trace, group_id) NOT IN (SELECT (trace_digest, group_id) FROM episodes WHERE group_id IS NOT NULL));
CREATE VIEW played AS FROM told WHERE end_reason IS NOT NULL;
-- A row a call, beside all of its episode.
CREATE VIEW calls AS SELECT e.*, call FROM told e, unnest(e.steps) AS of_episode(call);

-- How often something holds, and in what share of the rows (or of those among them) it does; unknown counts for neither.
CREATE MACRO tally(holds) AS count(*) FILTER (holds);
CREATE MACRO share(holds) AS avg(holds::INT), (holds, among) AS avg(holds::INT) FILTER (among);
CREATE MACRO occurrences(word, pattern) AS len(regexp_extract_all(word, pattern));
CREATE MACRO family_order(family) AS list_position(['FDP', 'FODP', 'FDO', 'SUL', 'all'], family);

-- Wilson's interval: the roots of (p - won / n)^2 = z^2 p (1 - p) / n, by the quadratic formula.
CREATE MACRO root(won, n, side) AS (
  (2 * won + zz() + side * sqrt(zz() * (zz() + 4 * won * (1 - won / n)))) / (2 * (n + zz()))
);
CREATE MACRO zz() AS 1.959963984540054e0 * 1.959963984540054e0;
CREATE MACRO low(won, n) AS CASE WHEN n > 0 THEN greatest(root(won, n, -1), 0) END;
CREATE MACRO high(won, n) AS CASE WHEN n > 0 THEN least(root(won, n, 1), 1) END;
