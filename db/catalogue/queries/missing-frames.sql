-- missing-frames: Which planned steps have no good frame?
-- A good frame is one whose level check did not fail. Complete sessions have proven every step when they were captured;
-- `stratalux-db verify` looks at them again.
-- parameters: since until rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column status       text   degraded, failed or recording
-- column planned      number steps of the plan
-- column good         number steps with a good frame
-- column missing      number steps without
-- column steps        text   the missing ones, such as 3, 17-20
WITH candidates AS (
  SELECT s.number, s.id, s.started_wall_ns, s.rig, s.status, planned_steps(s.plan_json) AS planned,
         (SELECT count(*) FROM (SELECT DISTINCT f.step FROM frames f WHERE f.session = s.number AND f.level_check <> 2))
           AS good
  FROM sessions s
  WHERE s.status <> 'complete' AND s.plan_json <> ''
    AND s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
    AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
    AND (:rig IS NULL OR s.rig = :rig)),
short AS MATERIALIZED (
  SELECT * FROM candidates WHERE good < planned ORDER BY number DESC LIMIT coalesce(:limit, -1))
SELECT id AS session, started_wall_ns AS started, rig, status, planned, good, planned - good AS missing,
       -- The step behind the last one of the plan ends the search.
       (SELECT missing_steps(step) FROM (SELECT f.step FROM frames f WHERE f.session = short.number AND f.level_check <> 2
                                         UNION ALL SELECT short.planned)) AS steps
FROM short
ORDER BY number DESC
