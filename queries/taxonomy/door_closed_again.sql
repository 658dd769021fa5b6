-- door_closed_again
--
-- A door that was opened was closed again before what is behind it was reached, and stayed closed: a call met it closed, or the agent did not
-- leave in between. (Who leaves, comes back and tidies up had not looked inside.) The decisive step is the closing.
--
-- Class: Lost Memory
-- Sub-class: door_closed_again
-- Priority: 18
-- Needs: goal
SELECT sequence_find(steps, 'close[ok and receptacle_match in (''src'', ''dest'')] !open[ok]* $') AS found
FROM episodes
WHERE sequence_match(steps, 'open[ok] .. close[ok and receptacle_match in (''src'', ''dest'')] !open[ok]* _[error_code = ''door_closed''] !open[ok]* $')
   OR sequence_match(steps, '^ !pick[ok and goal_object]* open[ok and receptacle_match = ''src''] !(pick[ok and goal_object] | nav_to[ok])* close[ok and receptacle_match = ''src''] !(open[ok] | pick[ok and goal_object])* $')
