-- undone_success
--
-- An object stood where the goal wants it, and was taken away again and not brought back: that it was done was forgotten. The
-- decisive step is the call that took it.
--
-- Class: Lost Memory
-- Sub-class: undone_success
-- Priority: 16
-- Needs: goal
SELECT sequence_find(steps, '_[goals_met < goals_met@-1] !_[goals_met > goals_met@-1]* $') AS found
FROM episodes
