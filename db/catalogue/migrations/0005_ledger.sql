-- Schema 5: what the review of the store asked for. Frozen once released.

-- XXH3-128 of the samples (encrypted sessions: keyed BLAKE2b-128 under the session's key); NULL before schema 5.
-- It stays when a frame is transcoded: fits name frames by it.
ALTER TABLE frames ADD COLUMN pixel_hash BLOB /* of the samples, whatever the codec; NULL before schema 5 */;

-- Opening a store asks for sessions whose writer is gone: of a hundred thousand sessions one at most.
CREATE INDEX sessions_recording ON sessions (number) WHERE status = 'recording';

-- How far the index has followed each chain of ledger/ (db/catalogue/ledger_follow.h): bytes of it whose withdrawals and
-- forgettings stand in consents and deletions.
CREATE TABLE ledger_heads (
  chain             TEXT    PRIMARY KEY,                 -- file name in ledger/; '': withdrawals of before were taken over
  bytes             INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
