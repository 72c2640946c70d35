-- findings: What did captures find, newest first?
-- A moved visitor, a lamp, missing proofs, devices that failed: one row a finding, in the order of the capture. What
-- value and limit are depends on the kind. The view session_findings, with its parameters.
-- parameters: since until rig kind limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visit        text   shared by its attempts; empty: not one of several
-- column attempt      number of the visit, from 1; 0: not counted
-- column status       text   complete, degraded or failed
-- column kind         text   of the finding, such as moved
-- column projector    number 0-based; none: all of them, or no projector
-- column step         number of the plan; none: no step
-- column value        number what was found
-- column limit        number that it was compared with
-- column detail       text   a device's own words
SELECT f.id AS session, f.started_wall_ns AS started, f.rig, f.visit, f.attempt, f.status, f.kind, f.projector, f.step,
       f.value, f."limit", f.detail
FROM session_findings f
-- The plus keeps SQLite at the index of the few sessions in which anything was found.
WHERE +f.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND +f.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR f.rig = :rig)
  AND (:kind IS NULL OR f.kind = :kind)
ORDER BY f.session DESC, f.finding
LIMIT coalesce(:limit, -1)
