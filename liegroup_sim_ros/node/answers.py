# SPDX-License-Identifier: Apache-2.0
"""How a node answers: every request has a response, whatever its callback raises, and none blocks the others.

A callback of a service gets (request, response) and returns the response, or one line of text for a
response that says success. It may be a coroutine, and wait for what other threads do: until then the
executor runs other callbacks. What it raises becomes a response, too.
"""

import concurrent.futures
import inspect
import threading

from rclpy.node import Node

from liegroup_core.errors import LieGroupSimError

from .standard_codes import FAILED, OK, Refused

FIRST, NEXT = 0.02, 0.002  # s for which the executor waits at first, and between other callbacks
SHOWN = 300  # characters of an unexpected error
ENDING = "the node is shutting down"


class AnsweringNode(Node):
    """Node all of whose services and subscriptions outlive what their callbacks raise.

    signals : Signals, as an attribute `signals` before services are called
    """

    def create_service(self, srv_type, srv_name, callback, **options):
        """As Node.create_service; see above for what the callback may return."""

        def serve(request, _):
            work = self._answer(srv_type, srv_name, callback, request)
            try:
                work.send(None)
            except StopIteration as done:
                return done.value
            return work  # it waits; `send` goes on with it

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
        """As Node.create_subscription."""

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
        """Result of a concurrent Future. Raises its exception, Refused if the node ends or not `alive`."""
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
    """Future of a function that runs in a thread of its own, which does not keep the process alive."""
    future = concurrent.futures.Future()

    def run():
        try:
            future.set_result(work(*arguments))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


def filled(response, code, text):
    """The response of a service with its result, in the fields that its type has."""
    result = getattr(response, "result", None)
    if hasattr(response, "success"):
        response.success, response.message = code == OK, text
    elif hasattr(result, "successful"):
        result.successful, result.reason = code == OK, text
    elif hasattr(result, "error_message"):
        result.result, result.error_message = code, text
    return response
