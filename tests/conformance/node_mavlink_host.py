#!/usr/bin/env python3
"""node-mavlink with the emulated PX4, over TCP: its list of parameters, and the interval of a message.

Needs a folder into which npm has installed node-mavlink.
"""

import json
import pathlib
import shutil
import subprocess

import emulated

PROGRAM = r"""
const net = require('net')
const { MavLinkPacketSplitter, MavLinkPacketParser, MavLinkProtocolV2, send, minimal, common } = require('node-mavlink')

const [host, port] = process.argv.slice(-2)
const registry = { ...minimal.REGISTRY, ...common.REGISTRY }
const line = net.connect(Number(port), host)
const found = { parameters: [], interval: null, acknowledged: null, byIndex: null, frames: 0 }
const reader = line.pipe(new MavLinkPacketSplitter()).pipe(new MavLinkPacketParser())
reader.on('data', packet => {
  const kind = registry[packet.header.msgid]
  if (!kind) return
  ++found.frames
  const data = packet.protocol.data(packet.payload, kind)
  if (data instanceof common.ParamValue) {
    if (found.parameters.length < data.paramCount) found.parameters.push(data.paramId)
    else found.byIndex = data.paramId
  }
  if (data instanceof common.MessageInterval) found.interval = data.intervalUs
  if (data instanceof common.CommandAck) found.acknowledged = data.result
})
const ask = async message => { await send(line, message, new MavLinkProtocolV2()) }
const wait = ms => new Promise(done => setTimeout(done, ms))
line.on('connect', async () => {
  const list = new common.ParamRequestList()
  list.targetSystem = 1
  list.targetComponent = 1
  await ask(list)
  await wait(500)
  const one = new common.ParamRequestRead()
  one.targetSystem = 1
  one.targetComponent = 1
  one.paramId = ''
  one.paramIndex = 3
  await ask(one)
  await wait(300)
  const command = new common.CommandLong()
  command.targetSystem = 1
  command.targetComponent = 1
  command.command = 510
  command._param1 = 0
  await ask(command)
  await wait(1500)
  console.log(JSON.stringify(found))
  process.exit(0)
})
"""


def run(arguments, checks):
    node = shutil.which("node")
    if node is None or not arguments.host:
        return None
    folder = pathlib.Path(arguments.host)
    version = json.loads((folder / "node_modules" / "node-mavlink" / "package.json").read_text())["version"]
    sections = emulated.ACCELEROMETER.format(driver="mavlink", port="tcp:0", more="")
    with emulated.bench(arguments.abcal, sections,
                        simulation=emulated.IN_MPS2) as bench:
        host, port = bench.tcp("accelerometer")
        done = subprocess.run([node, "-e", PROGRAM, "--", host, str(port)], cwd=folder, capture_output=True, text=True,
                              timeout=60)
        found = checks.step("connects and reads", lambda: json.loads(done.stdout.splitlines()[-1]))
        if found is None:
            return version
        checks.step("all parameters", lambda: found["parameters"],
                    lambda names: len(names) == 9 and "CAL_ACC0_XOFF" in names)
        checks.step("a parameter by its index", lambda: found["byIndex"] == found["parameters"][3], True)
        checks.step("interval of the heartbeat", lambda: (found["interval"], found["acknowledged"]), (1000000, 0))
        checks.step("frames", lambda: found["frames"], lambda count: count > 10)
        checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return version


emulated.main("node-mavlink", "PX4 (mavlink), TCP", run)
