"""The panels beside the map, without a browser."""
import os
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from diffdrive_ros.core.kinematics import DiffDrive
from diffdrive_ros.node import steady_clock
import pytest

if not os.environ.get('CI'):
    pytest.importorskip('nicegui', reason='nicegui is not installed')


def type_into(field: Any, value: float) -> None:
    """Have a field receive the events of a browser where a person typed a value."""
    for listener in list(field._event_listeners.values()):
        if listener.type.startswith('update'):
            field._handle_event({'listener_id': listener.id, 'client_id': '', 'args': value})


def test_diagnostics_panel_lists_statuses_once_a_second(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a change, nothing is sent to the page; statuses that end are shown as silent."""
    from diffdrive_ros.dashboard.panels import DiagnosticsPanel
    from nicegui import Client, ui

    statuses, now = {}, 100.0
    monkeypatch.setattr(steady_clock, 'steady', lambda: now)

    def receive(name: str, message: str) -> None:
        statuses[name] = now, DiagnosticStatus(name=name, message=message, level=b'\x01')

    def titles() -> list[str]:
        rows = panel._list.default_slot.children
        return [row.default_slot.children[0].text for row in rows]

    with Client(ui.page('/')) as client:
        panel = DiagnosticsPanel(SimpleNamespace(diagnostics=statuses))
        receive('b', 'well')
        panel.refresh()
        receive('b', 'ill')
        receive('a', 'well')
        panel.refresh()
        assert titles() == ['WARN  b: well']
        now += 1.0
        panel.refresh()
        assert titles() == ['WARN  a: well', 'WARN  b: ill']
        sent = []
        monkeypatch.setattr(client.outbox, 'enqueue_update', sent.append)
        now += 1.0
        panel.refresh()
        assert sent == []
        now += 5.0
        receive('a', 'well')
        panel.refresh()
        assert titles() == ['WARN  a: well', 'SILENT  b: ill']
        client.delete()


def test_kinematics_panel_shows_dragged_then_live_wheels() -> None:
    """Writing one field is no input of a person while the other has its old value."""
    from diffdrive_ros.dashboard.panels import KinematicsPanel
    from nicegui import Client, ui

    drive = DiffDrive(0.3, 0.05, 0.051)
    robot = SimpleNamespace(
        odom=(0.1, 0.2, 0.3), wheels=(7.0, 8.0), is_silent=False,
        parameters=SimpleNamespace(drive=drive))
    texts, drawn, handlers = {}, [], {}
    robot_map = SimpleNamespace(
        on_data=handlers.setdefault, set_texts=texts.update,
        draw_measured=lambda: drawn.append(None),
        draw_dragged=lambda pose, wheels: drawn.append(wheels))
    permission = SimpleNamespace(on_current=lambda *_: None)
    with Client(ui.page('/')) as client:
        panel = KinematicsPanel(robot, robot_map, permission)
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        handlers['drag']({'wheels': [7.5, 8.5]})
        assert panel.wheels == (7.5, 8.5)
        assert drawn == []
        assert "φ' = H V_b  = (7.50, 8.50)" in texts['equations']
        assert drawn == []
        type_into(panel._left, 3.0)
        assert drawn.pop() == panel.wheels == (3.0, 8.5)
        panel._on_live()
        assert drawn == [None]
        assert "φ' = H V_b  = (7.00, 8.00)" in panel.equations()
        client.delete()
