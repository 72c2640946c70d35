-- recent-access: Who showed, exported or opened which session?
-- parameters: since until limit
-- column at           time   UTC
-- column who          text   operating-system user
-- column action       text
-- column session      text   id; the session itself may be gone
-- column detail       text   such as the folder of an export
SELECT a.at_wall_ns AS at, a.who, a.action, a.session_id AS session, a.detail
FROM access_log a
WHERE a.at_wall_ns >= coalesce(:since_ns, -9223372036854775808)
  AND a.at_wall_ns < coalesce(:until_ns, 9223372036854775807)
ORDER BY a.number DESC
LIMIT coalesce(:limit, -1)
