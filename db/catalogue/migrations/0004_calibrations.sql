-- Schema 4: calibrations that the fitter accepted, as versions of their rig with a time they are good for.

-- A fit whose folder holds calibration.json. Goes with the fit, and with the session it belongs to.
CREATE TABLE accepted_calibrations (
  session             INTEGER NOT NULL,
  fit                 TEXT    NOT NULL,
  calibration_id      TEXT    NOT NULL REFERENCES calibrations (id),
  made_wall_ns        INTEGER NOT NULL,
  valid_until_wall_ns INTEGER NOT NULL,
  PRIMARY KEY (session, fit),
  FOREIGN KEY (session, fit) REFERENCES fits (session, id) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE INDEX accepted_by_calibration ON accepted_calibrations (calibration_id);

-- One row an accepted record. Versions count from 1 in the order in which the rig was captured for them, then in that of
-- their making; simulated rigs and real ones count apart. A record that was accepted twice has its last place.
CREATE VIEW calibration_versions AS
  SELECT id, rig, simulated, session_id, fit, made_wall_ns, valid_until_wall_ns,
         row_number() OVER versions AS version, lead(id) OVER versions AS superseded_by
  FROM (SELECT a.calibration_id AS id, s.rig, s.simulated, s.id AS session_id, a.fit, a.made_wall_ns,
               a.valid_until_wall_ns, f.created_wall_ns,
               row_number() OVER (PARTITION BY a.calibration_id ORDER BY f.created_wall_ns DESC, a.fit DESC) AS copy
        FROM accepted_calibrations a
        JOIN sessions s ON s.number = a.session
        JOIN fits f ON f.session = a.session AND f.id = a.fit)
  WHERE copy = 1
  WINDOW versions AS (PARTITION BY rig, simulated ORDER BY made_wall_ns, created_wall_ns, fit);

-- As in schema 3, and what the record itself says of its making; version, validity and successor of accepted ones.
DROP VIEW calibration_overview;
CREATE VIEW calibration_overview AS
  SELECT c.id, c.rig, c.source, c.made_wall_ns,
         coalesce(c.made_wall_ns,
                  (SELECT m.started_wall_ns FROM sessions m WHERE c.source = 'calibration session ' || m.id),
                  (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id)) AS since_wall_ns,
         (SELECT min(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS first_used_wall_ns,
         (SELECT max(s.started_wall_ns) FROM sessions s WHERE s.calibration_id = c.id) AS last_used_wall_ns,
         (SELECT count(*) FROM sessions s WHERE s.calibration_id = c.id) AS sessions,
         v.version, v.session_id AS made_by, v.fit, v.superseded_by,
         coalesce(v.valid_until_wall_ns, c.valid_until_wall_ns) AS valid_until_wall_ns
  FROM (SELECT id,
               coalesce(made_wall_ns, CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.made_wall_ns') END)
                 AS made_wall_ns,
               CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.valid_until_wall_ns') END
                 AS valid_until_wall_ns,
               -- Records of schema 1 do not know their rig; the sessions do.
               coalesce(nullif(rig, ''), (SELECT s.rig FROM sessions s WHERE s.calibration_id = calibrations.id LIMIT 1), '')
                 AS rig,
               coalesce(CASE WHEN json_valid(record_json) THEN json_extract(record_json, '$.source') END, '') AS source
        FROM calibrations) c
  LEFT JOIN calibration_versions v ON v.id = c.id;
