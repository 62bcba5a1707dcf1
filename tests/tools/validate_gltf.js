// Prints the Khronos validator's report on a glTF file as JSON.
const fs = require("fs");
const validator = require("gltf-validator");

const file = process.argv[2];
validator
  .validateBytes(new Uint8Array(fs.readFileSync(file)), { uri: file, maxIssues: 0 })
  .then((report) => console.log(JSON.stringify(report)));
