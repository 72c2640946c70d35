-- failures: Why were sessions degraded or failed?
-- Reasons that differ in their numbers alone are counted together (N stands for a number). The view failures, with its
-- parameters.
-- parameters: since until rig limit
-- column status       text   degraded or failed
-- column reason       text
-- column sessions     number
-- column rigs         number on which it happened
-- column last         time   start of the newest such session, UTC
-- column example      text   its id
SELECT r.status, r.reason_class AS reason, count(DISTINCT r.session) AS sessions, count(DISTINCT r.rig) AS rigs,
       max(r.started_wall_ns) AS last, r.id AS example
FROM session_reasons r
WHERE r.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND r.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
  AND (:rig IS NULL OR r.rig = :rig)
GROUP BY r.status, r.reason_class
ORDER BY sessions DESC, r.status, r.reason_class
LIMIT coalesce(:limit, -1)
