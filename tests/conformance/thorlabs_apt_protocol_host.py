#!/usr/bin/env python3
"""thorlabs-apt-protocol with the emulated Thorlabs controllers, over TCP: it writes the requests and reads the answers,
whose layouts it knows."""

import importlib.util
import itertools
import pathlib
import shutil
import socket
import sys
import tempfile
import time

import emulated

HOST = 0x01
REQUESTS = ["mod_req_chanenablestate", "mod_req_digoutputs", "mot_req_poscounter", "mot_req_enccounter",
            "mot_req_velparams", "mot_req_jogparams", "mot_req_adcinputs", "mot_req_powerparams",
            "mot_req_genmoveparams", "mot_req_moverelparams", "mot_req_moveabsparams", "mot_req_homeparams",
            "mot_req_limswitchparams", "mot_req_bowindex", "mot_req_dcpidparams", "mot_req_avmodes",
            "mot_req_potparams", "mot_req_motoroutputparams",
            "mot_req_tracksettleparams", "mot_req_profilemodeparams",
            "mot_req_currentloopoarams", "mot_req_settledcurrentloopparams", "mot_req_trigger",
            "mot_req_statusupdate", "mot_req_dcstatusupdate"]
# Its parsers of the parameters of position loop and joystick count wrongly: left out. Requests without a channel:
PLAIN = {"mod_req_digoutputs"}


class Line:
    """A connection, from which messages are read one by one."""

    def __init__(self, address, unpacker):
        self.socket = socket.create_connection(address, timeout=5)
        self.socket.settimeout(0.02)
        self.unpacker = unpacker(self)
        self.buffer = b""

    def read(self, size):
        """For the unpacker: what there is, at most `size` bytes; empty if nothing came for some time."""
        try:
            return self.socket.recv(size)
        except TimeoutError:
            return b""

    def messages(self, seconds):
        """All that come within this time."""
        found = []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found += list(itertools.islice(self.unpacker, 20))
        return found

    def wait_for(self, name, seconds, condition=lambda message: True):
        """The first message of this name that fulfils the condition."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for message in self.unpacker:
                if message.msg == name and condition(message):
                    return message
        return None


def library(arguments):
    """The package and its unpacker; None if they are not there. A line of the checkout stands where Python does not
    permit it; the package is loaded from a copy without this line."""
    if arguments.host:
        folder = pathlib.Path(tempfile.mkdtemp()) / "thorlabs_apt_protocol"
        shutil.copytree(pathlib.Path(arguments.host) / "thorlabs_apt_protocol", folder)
        functions = folder / "functions.py"
        functions.write_text("from __future__ import annotations\n" +
                             functions.read_text().replace("from __future__ import annotations\n", ""))
        sys.path.insert(0, str(folder.parent))
    if importlib.util.find_spec("thorlabs_apt_protocol") is None:
        return None
    import thorlabs_apt_protocol
    from thorlabs_apt_protocol.unpacker import Unpacker
    return thorlabs_apt_protocol, Unpacker


def run_on(arguments, checks, sections, model, address, status):
    """`status`: the name of the messages that come without being asked for."""
    found = library(arguments)
    if found is None:
        return None
    apt, Unpacker = found
    with emulated.bench(arguments.abcal, sections, model=model) as bench:
        name = "stage-z" if "stage-z" in bench.ports else "stage"
        line = Line(bench.tcp(name), Unpacker)
        line.socket.sendall(apt.hw_req_info(address, HOST))
        checks.step("identity", lambda: line.wait_for("hw_get_info", 2).model_number.rstrip(b"\0").decode(),
                    lambda text: text in ("BBD202", "K10CR1"))

        def ask(request):
            function = getattr(apt, request)
            line.socket.sendall(function(address, HOST) if request in PLAIN else function(address, HOST, 1))
            answer = {"mod_req_chanenablestate": "mod_get_chanenablestate"}.get(request, request.replace("_req_", "_get_"))
            return line.wait_for(answer, 1) is not None

        answered = [request for request in REQUESTS if ask(request)]
        checks.step(f"{len(REQUESTS)} requests answered and parsed", lambda: answered, REQUESTS)
        line.socket.sendall(apt.hw_start_updatemsgs(address, HOST))
        checks.step("status ten times a second", lambda: sum(m.msg == status for m in line.messages(1.0)),
                    lambda count: 7 <= count <= 12)
        line.socket.sendall(apt.mot_move_home(address, HOST, 1))
        checks.step("the status says homed", lambda: line.wait_for(status, 30, lambda m: m.homed) is not None, True)
        line.socket.sendall(apt.mot_move_jog(address, HOST, 1, 1))
        checks.step("jog, and its end", lambda: line.wait_for("mot_move_completed", 30) is not None, True)
        line.socket.sendall(apt.mot_set_moveabsparams(address, HOST, 1, 40960) + apt.mot_move_absolute(address, HOST, 1))
        checks.step("move to a place set before", lambda: line.wait_for("mot_move_completed", 30) is not None, True)
        line.socket.sendall(apt.hw_stop_updatemsgs(address, HOST))
        line.messages(0.2)
        checks.step("no status any more", lambda: len(line.messages(0.5)), 0)
        checks.step("nothing unknown was asked", lambda: bench.status()["unserved"], [])
    return apt.__version__


def rack(arguments, checks):
    sections = emulated.STAGE.format(driver="thorlabs_apt", port="tcp:127.0.0.1:0")
    return run_on(arguments, checks, sections, "", 0x21, "mot_get_dcstatusupdate")


def unit(arguments, checks):
    sections = """
[stage.x]
driver = "thorlabs_apt"
port = "tcp:127.0.0.1:0"
axis = "1"
[stage.z]
driver = "thorlabs_apt"
port = "tcp:127.0.0.1:0"
axis = "1"
[accelerometer]
driver = "simulated"
"""
    return run_on(arguments, checks, sections, 'stage_model = "K10CR1"', 0x50, "mot_get_statusupdate")


emulated.main("thorlabs-apt-protocol", "Thorlabs BBD202 with DDR100 (thorlabs_apt), TCP", rack,
              "Thorlabs K10CR1 (thorlabs_apt), TCP", unit)
