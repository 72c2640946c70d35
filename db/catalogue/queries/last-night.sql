-- last-night: What was captured last night, and what became of it?
-- The night lasts from noon to noon, local time; --since and --until choose another span.
-- parameters: since until rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column kind         text   visitor, calibration, dark, flat or response
-- column status       text   recording, complete, degraded or failed
-- column frames       number stored
-- column retakes      number frames shot again
-- column bytes        bytes  payloads on disk
-- column fits         number
-- column reason       text   the first reason why it is degraded or failed
WITH night (since_ns, until_ns) AS (
  SELECT coalesce(:since_ns, 1000000000 * strftime('%s', :now_ns / 1000000000, 'unixepoch', 'localtime',
                                                   'start of day', '-12 hours', 'utc')),
         coalesce(:until_ns, CASE WHEN :since_ns IS NULL
                                  THEN 1000000000 * strftime('%s', :now_ns / 1000000000, 'unixepoch', 'localtime',
                                                             'start of day', '+12 hours', 'utc')
                                  ELSE 9223372036854775807 END))
SELECT s.id AS session, s.started_wall_ns AS started, s.rig, s.visitor, s.kind, s.status, s.frame_count AS frames,
       (SELECT count(*) FROM proofs p INDEXED BY proofs_retakes WHERE p.session = s.number AND p.retake_cause <> '')
         AS retakes,
       s.stored_bytes AS bytes, (SELECT count(*) FROM fits f WHERE f.session = s.number) AS fits,
       CASE WHEN json_valid(s.reasons_json) THEN json_extract(s.reasons_json, '$[0]') END AS reason
FROM night CROSS JOIN sessions s ON s.started_wall_ns >= night.since_ns AND s.started_wall_ns < night.until_ns
WHERE :rig IS NULL OR s.rig = :rig
ORDER BY s.number DESC
LIMIT coalesce(:limit, -1)
