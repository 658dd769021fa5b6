-- false_history
--
-- The History claims that the target was picked or put down, and the record holds no such success: what was not done is
-- remembered as done. The decisive step is the first that says so.
--
-- Class: Lost Memory
-- Sub-class: false_history
-- Priority: 22
-- Needs: goal
SELECT CASE
  WHEN NOT sequence_match(steps, 'pick') THEN sequence_find(
    steps,
    '_[history like ''%picked%'' or history like ''%grasped%'' or history like ''%took %'' or history like ''%taken%'' or history like ''%in my hand%'' or history like ''%in the gripper%'' or history like ''%holding%'' or history like ''%got hold%'' or history like ''%is with me%''] !(gaze_at | show_object_by_category)* $'
  )
  WHEN NOT sequence_match(steps, 'pick[ok]') THEN sequence_find(
    steps,
    '_[(history like ''%picked%'' or history like ''%grasped%'' or history like ''%took %'' or history like ''%taken%'' or history like ''%in my hand%'' or history like ''%in the gripper%'' or history like ''%holding%'' or history like ''%got hold%'' or history like ''%is with me%'') and not history like ''%failed%''] !(pick | gaze_at | show_object_by_category)* $'
  )
  WHEN NOT sequence_match(steps, 'place') THEN sequence_find(
    steps,
    '_[history like ''%placed%'' or history like ''%put %'' or history like ''%deposited%'' or history like ''%set down%'' or history like ''%set it%'' or history like ''%delivered%'' or history like ''%dropped off%'' or history like ''%moved it%'' or history like ''%left it%'' or history like ''% is on % now%'' or history like ''%is now on %'' or history like ''%stands on %'']'
  )
  WHEN NOT sequence_match(steps, 'place[ok]') THEN sequence_find(
    steps,
    '_[(history like ''%placed%'' or history like ''%put %'' or history like ''%deposited%'' or history like ''%set down%'' or history like ''%set it%'' or history like ''%delivered%'' or history like ''%dropped off%'' or history like ''%moved it%'' or history like ''%left it%'' or history like ''% is on % now%'' or history like ''%is now on %'' or history like ''%stands on %'') and not history like ''%failed%'']'
  )
END AS found
FROM episodes
