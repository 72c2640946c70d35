-- missing-frames: Which planned steps have no good frame?
-- A good frame is one whose level check did not fail, neither when it was stored nor by what the capture found later.
-- Complete sessions have proven every step when they were captured; `stratalux-db verify` looks at them again. The view
-- missing_frames, with its parameters.
-- parameters: since until rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column status       text   degraded, failed or recording
-- column planned      number steps of the plan
-- column good         number steps with a good frame
-- column missing      number steps without
-- column steps        text   the missing ones, such as 3, 17-20
SELECT m.id AS session, m.started_wall_ns AS started, m.rig, m.status, m.planned, m.good, m.missing, m.steps
FROM missing_frames m
-- The plus keeps SQLite from the index of starts, which would have every session answered before the newest few are taken.
WHERE +m.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND +m.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR m.rig = :rig)
ORDER BY m.session DESC
LIMIT coalesce(:limit, -1)
