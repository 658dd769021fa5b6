-- x
--
-- Class: Lost Memory
-- Sub-class: a
-- Priority: 99999999999999999999
-- Secondary: never
SELECT 1