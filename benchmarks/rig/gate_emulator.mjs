// firmware/emulated_gate.c on an emulated RP2040: one call a line in, "CALL N HEX"; its answer in hexadecimal out.
//     node gate_emulator.mjs gate.elf FOLDER_OF_rp2040js
import { readFileSync } from 'node:fs';
import { createInterface } from 'node:readline';
import { pathToFileURL } from 'node:url';
const { RP2040 } = await import(pathToFileURL(process.argv[3] + '/dist/esm/index.js'));
const elf = readFileSync(process.argv[2]);
const chip = new RP2040();
const RAM = 0x20000000, BOX = 0x30000;
for (let i = 0; i < elf.readUInt16LE(44); i++) {
  const at = elf.readUInt32LE(28) + i * elf.readUInt16LE(42);
  if (elf.readUInt32LE(at) !== 1) continue;
  const from = elf.readUInt32LE(at + 4), to = elf.readUInt32LE(at + 8), n = elf.readUInt32LE(at + 16);
  chip.sram.set(elf.subarray(from, from + n), to - RAM);
}
chip.core.SP = RAM + 0x2f000;
chip.core.PC = elf.readUInt32LE(24) & ~1;
const view = new DataView(chip.sram.buffer, chip.sram.byteOffset);
createInterface({ input: process.stdin }).on('line', (line) => {
  const [call, n, hex] = line.split(' ');
  chip.sram.set(Buffer.from(hex ?? '', 'hex'), BOX + 8);
  view.setUint32(BOX + 4, Number(n), true);
  view.setUint32(BOX, Number(call), true);
  while (view.getUint32(BOX, true) !== 0) { chip.core.executeInstruction(); }
  const size = view.getUint32(BOX + 4, true) * (call === '3' ? 2 : 1);
  console.log(call === '3' || call === '5' ? Buffer.from(chip.sram.subarray(BOX + 8, BOX + 8 + size)).toString('hex') : '');
});
