-- Schema 6: what a capture found, as data, and the visit that it is an attempt of. Frozen once released.

ALTER TABLE sessions ADD COLUMN visit TEXT NOT NULL DEFAULT '' /* shared by the attempts of one visit; empty: not one of several */;
ALTER TABLE sessions ADD COLUMN attempt INTEGER NOT NULL DEFAULT 0 /* of the visit, from 1; 0: not counted */;
ALTER TABLE sessions ADD COLUMN findings_json TEXT NOT NULL DEFAULT '[]' /* array of findings, as in the manifest; rows: session_findings */;
ALTER TABLE sessions ADD COLUMN faults_json TEXT NOT NULL DEFAULT '{}' /* shots that did not count, by the fault's name; rows: session_faults */;

CREATE INDEX sessions_by_visit ON sessions (visit, attempt);
-- The few that have any: session_findings and session_faults read no other, the newest first.
CREATE INDEX sessions_found ON sessions (number) WHERE findings_json <> '[]';
CREATE INDEX sessions_faulty ON sessions (number) WHERE faults_json <> '{}';

-- One row a finding, in the order of the capture (`finding`, from 0). What value and limit are, is said of each kind in
-- docs/file-formats.md. projector and step are NULL where the finding has none, detail where the numbers say all.
CREATE VIEW session_findings AS
  SELECT s.number AS session, s.id, s.rig, s.kind AS session_kind, s.status, s.visit, s.attempt, s.started_wall_ns,
         f.key AS finding,
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.kind') END AS kind,
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.projector') END AS projector,
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.step') END AS step,
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.value') END AS value,
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.limit') END AS "limit",
         CASE f.type WHEN 'object' THEN json_extract(f.value, '$.detail') END AS detail,
         strftime('%Y-%m-%dT%H:%M:%S', s.started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', s.started_wall_ns % 1000000000) AS started
  FROM sessions s
  JOIN json_each(CASE WHEN json_valid(s.findings_json) THEN s.findings_json ELSE '[]' END) f
  WHERE s.findings_json <> '[]' AND f.type = 'object';

-- One row a fault of a session: how many shots did not count for it.
CREATE VIEW session_faults AS
  SELECT s.number AS session, s.id, s.rig, s.kind AS session_kind, s.status, s.visit, s.attempt, s.started_wall_ns,
         f.key AS fault, f.value AS shots,
         strftime('%Y-%m-%dT%H:%M:%S', s.started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', s.started_wall_ns % 1000000000) AS started
  FROM sessions s
  JOIN json_each(CASE WHEN json_valid(s.faults_json) THEN s.faults_json ELSE '{}' END) f
  WHERE s.faults_json <> '{}' AND f.type = 'integer';

-- As in schema 5, with the visit and how much was found.
DROP VIEW session_overview;
CREATE VIEW session_overview AS
  SELECT s.number, s.id, s.kind, s.rig, s.visitor, s.visit, s.attempt, s.status, s.simulated, s.retention, s.started_wall_ns,
         s.finished_wall_ns, s.calibration_id, s.key_id IS NOT NULL AS encrypted, s.frame_count AS frames,
         s.stored_bytes AS bytes, (SELECT count(*) FROM fits t WHERE t.session = s.number) AS fits, s.planned_steps,
         CASE WHEN json_valid(s.findings_json) THEN json_array_length(s.findings_json) END AS findings,
         strftime('%Y-%m-%dT%H:%M:%S', s.started_wall_ns / 1000000000, 'unixepoch')
           || printf('.%09dZ', s.started_wall_ns % 1000000000) AS started,
         strftime('%Y-%m-%dT%H:%M:%S', nullif(s.finished_wall_ns, 0) / 1000000000, 'unixepoch')
           || printf('.%09dZ', nullif(s.finished_wall_ns, 0) % 1000000000) AS finished,
         CASE WHEN json_valid(s.reasons_json) THEN json_extract(s.reasons_json, '$[0]') END AS first_reason,
         CASE WHEN s.consent <> '' OR json_valid(s.consent_json) THEN json_object(
           'text_version', coalesce(json_extract(s.consent_object, '$.text_version'), s.consent),
           'language', coalesce(json_extract(s.consent_object, '$.language'), ''),
           'scope', json(CASE json_type(s.consent_object, '$.scope') WHEN 'array'
                         THEN json_extract(s.consent_object, '$.scope') ELSE '[]' END),
           'given_wall_ns', coalesce(json_extract(s.consent_object, '$.given_wall_ns'), 0),
           'withdrawn', (SELECT c.withdrawn FROM session_consents c WHERE c.session = s.number)) END AS consent
  FROM (SELECT *, CASE WHEN json_valid(consent_json) THEN consent_json ELSE '{}' END AS consent_object FROM sessions) s;
