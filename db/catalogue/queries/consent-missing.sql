-- consent-missing: Which visitors' sessions are here without a valid consent?
-- Simulated sessions show nobody. A withdrawn consent calls for `stratalux-db forget`.
-- parameters: since until rig limit
-- column session      text   id
-- column started      time   UTC
-- column rig          text
-- column visitor      text   pseudonym
-- column problem      text   none kept, withdrawn, or fitted without that scope
-- column fits         number
WITH visits AS (
  SELECT s.*, (SELECT count(*) FROM fits f WHERE f.session = s.number) AS fits, c.withdrawn_wall_ns
  FROM sessions s JOIN session_consents c ON c.session = s.number
  WHERE s.kind = 'visitor' AND s.simulated = 0
    AND s.started_wall_ns >= coalesce(:since_ns, -9223372036854775808)
    AND s.started_wall_ns < coalesce(:until_ns, 9223372036854775807)
    AND (:rig IS NULL OR s.rig = :rig)),
judged AS (
  SELECT *, CASE WHEN withdrawn_wall_ns IS NOT NULL THEN 'withdrawn'
                 WHEN consent = '' AND NOT json_valid(consent_json) THEN 'none kept'
                 WHEN fits > 0 AND json_valid(consent_json) AND NOT EXISTS (
                   SELECT 1 FROM json_each(consent_json, '$.scope') scope WHERE scope.value = 'fit')
                 THEN 'fitted without that scope' END AS problem
  FROM visits)
SELECT id AS session, started_wall_ns AS started, rig, visitor, problem, fits
FROM judged
WHERE problem IS NOT NULL
ORDER BY number DESC
LIMIT coalesce(:limit, -1)
