// SPDX-License-Identifier: Apache-2.0
// Khronos' glTF validator over files: node gltf_validator.cjs NODE_MODULES FILE...
// A line a file: errors, warnings, infos, hints and the codes of all; exit 1 where a file has an error or a warning.
'use strict';
const fs = require('fs');
const path = require('path');
const [modules, ...files] = process.argv.slice(2);
const validator = require(path.join(modules, 'gltf-validator'));

async function main() {
  let bad = 0;
  for (const file of files) {
    const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
    const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
    const codes = messages.map((message) => message.code).join(' ');
    console.log(`${path.basename(file)}: errors ${numErrors} warnings ${numWarnings} infos ${numInfos} hints ${numHints} ${codes}`);
    bad += numErrors + numWarnings > 0 ? 1 : 0;
  }
  process.exitCode = bad > 0 ? 1 : 0;
}
main();
