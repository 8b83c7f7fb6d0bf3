# SPDX-License-Identifier: Apache-2.0
"""Base class of a node whose services always respond, also after an exception, and do not block each other.

A callback of a service gets (request, response). It returns the response, or one line of text for a
response that reports success. It may be a coroutine that waits for other threads: meanwhile the
executor runs other callbacks. An exception that it raises becomes a response, too.

Such a coroutine yields the Future that it waits for, and goes on in the executor when that is done. A coroutine of
rclpy would be called again and again until then.
"""

import concurrent.futures
import inspect
import threading
from collections.abc import Coroutine
from typing import NamedTuple

from rclpy.node import Node

from liegroup_core.errors import LieGroupSimError

from .standard_codes import FAILED, OK, Refused

PAUSE = 1e-3  # s, between two looks of a coroutine of rclpy
SHOWN = 300  # characters of an unexpected error
ENDING = "the node is shutting down"


class AnsweringNode(Node):
    """Node whose services and subscriptions survive exceptions of their callbacks."""

    def __init__(self, *arguments, **options):
        self._waiting = set()  # functions that continue a coroutine
        super().__init__(*arguments, **options)

    def create_service(self, srv_type, srv_name, callback, **options):
        """Same as Node.create_service; the module docstring says what the callback may return."""

        def serve(request, _):
            work = self._answer(srv_type, srv_name, callback, request)
            try:
                return _Waiting(work, work.send(None))
            except StopIteration as done:
                return done.value

        service = super().create_service(srv_type, srv_name, serve, **options)
        send_now = service.send_response

        def send(response, header):
            if isinstance(response, _Waiting):
                self._continue(*response, lambda answer: send_now(answer, header))
            else:
                send_now(response, header)

        service.send_response = send
        return service

    def _continue(self, work, future, send):
        """Continue a coroutine when the Future that it waits for is done; `send` takes its result."""

        def go_on():
            self._waiting.discard(go_on)
            try:
                following = work.send(None)
            except StopIteration as done:
                send(done.value)
            else:
                self._continue(work, following, send)

        self._waiting.add(go_on)
        # After `end_waits` there is no executor any more.
        future.add_done_callback(lambda _: self.executor.create_task(go_on) if go_on in self._waiting else None)

    def end_waits(self):
        """Answer what still waits, because the node ends and its executor no longer runs."""
        for go_on in list(self._waiting):
            go_on()

    def create_subscription(self, msg_type, topic, callback, qos_profile, **options):
        """Same as Node.create_subscription."""

        def receive(message):
            try:
                callback(message)
            except Exception as error:
                self._log_unexpected(topic, error)

        return super().create_subscription(msg_type, topic, receive, qos_profile, **options)

    async def _answer(self, kind, name, callback, request):
        response = kind.Response()
        try:
            result = callback(request, response)
            result = await result if inspect.isawaitable(result) else result
            return response if result is response else filled(response, OK, result or "")
        except Refused as refusal:
            return filled(kind.Response(), *refusal.args)
        except LieGroupSimError as error:
            return filled(kind.Response(), FAILED, str(error))
        except Exception as error:
            return filled(kind.Response(), FAILED, self._log_unexpected(name, error))

    def _log_unexpected(self, name, error):
        """Log an error in one line, at most once a second; returns the line."""
        text = f"{type(error).__name__}: {' '.join(str(error).split())}"[:SHOWN]
        self.get_logger().error(f"{name}: {text}", throttle_duration_sec=1.0)
        return text

    async def wait(self, future):
        """Result of a concurrent Future. Raises its exception, or Refused if the node ends before."""
        if not future.done():
            await Turn(future)
        if not future.done() or future.cancelled():
            raise Refused(FAILED, ENDING)
        return future.result()

    async def ask(self, name, *arguments):
        """Execute a command in the simulation thread. Raises CommandError, Refused."""
        return await self.wait(self.scene_run.server.call(name, *arguments))


class _Waiting(NamedTuple):
    """Coroutine, and the Future that it waits for."""

    work: Coroutine
    future: concurrent.futures.Future


DONE = concurrent.futures.Future()
DONE.set_result(None)


class Turn:
    """Awaitable that lets the executor run other callbacks, up to the end of a Future; by default once."""

    def __init__(self, future=DONE):
        self._future = future

    def __await__(self):
        yield self._future


async def in_executor(work):
    """Result of a coroutine as above in a coroutine of rclpy, which is called again and again: it pauses."""
    while True:
        try:
            future = work.send(None)
        except StopIteration as done:
            return done.value
        while not concurrent.futures.wait([future], PAUSE).done:
            await Turn()
        await Turn()


def begin(work, *arguments):
    """Run a function in a daemon thread of its own; returns its Future."""
    future = concurrent.futures.Future()

    def run():
        try:
            future.set_result(work(*arguments))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


def filled(response, code, text):
    """Write the result code and text to the fields that the response's type has; returns the response."""
    result = getattr(response, "result", None)
    if hasattr(response, "success"):
        response.success, response.message = code == OK, text
    elif hasattr(result, "successful"):
        result.successful, result.reason = code == OK, text
    elif hasattr(result, "error_message"):
        result.result, result.error_message = code, text
    return response
