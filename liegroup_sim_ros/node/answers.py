# SPDX-License-Identifier: Apache-2.0
"""Base class of a node whose services always respond, also after an exception, and do not block each other.

A callback of a service gets (request, response). It returns the response, or one line of text for a
response that reports success. It may be a coroutine that waits for other threads: meanwhile the
executor runs other callbacks. An exception that it raises becomes a response, too.
"""

import concurrent.futures
import inspect
import threading

from rclpy.node import Node

from liegroup_core.errors import LieGroupSimError

from .standard_codes import FAILED, OK, Refused

FIRST, NEXT = 0.02, 0.002  # s, waiting times of the executor: the first, and those between other callbacks
SHOWN = 300  # characters of an unexpected error
ENDING = "the node is shutting down"


class AnsweringNode(Node):
    """Node whose services and subscriptions survive exceptions of their callbacks.

    signals : Signals; attribute to set before services are called
    """

    def create_service(self, srv_type, srv_name, callback, **options):
        """Same as Node.create_service; the module docstring says what the callback may return."""

        def serve(request, _):
            work = self._answer(srv_type, srv_name, callback, request)
            try:
                work.send(None)
            except StopIteration as done:
                return done.value
            return work  # a coroutine that waits; `send` resumes it

        service = super().create_service(srv_type, srv_name, serve, **options)
        send_now = service.send_response

        def send(response, header):
            if not inspect.iscoroutine(response):
                send_now(response, header)
                return

            async def finish():
                while True:
                    try:
                        response.send(None)
                    except StopIteration as done:
                        send_now(done.value, header)
                        return
                    await Turn()

            self.executor.create_task(finish)

        service.send_response = send
        return service

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

    async def wait(self, future, alive=lambda: True):
        """Result of a concurrent Future. Raises its exception, or Refused if the node ends or `alive()` is false."""
        longest = FIRST
        while not concurrent.futures.wait([future], longest).done:
            if self.signals.received or not alive():
                raise Refused(FAILED, ENDING)
            longest = NEXT
            await Turn()
        try:
            return future.result()
        except concurrent.futures.CancelledError:
            raise Refused(FAILED, ENDING) from None

    async def ask(self, name, *arguments):
        """Execute a command in the simulation thread. Raises CommandError, Refused."""
        server = self.scene_run.server
        return await self.wait(server.call(name, *arguments), server.is_alive)


class Turn:
    """Awaitable that lets the executor run other callbacks once."""

    def __await__(self):
        yield


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
