/* A run of nassim in a process of Python. Requests and replies go through a pair of sockets, which are the process's
   standard input and output: nassim/exchange/python_run.py answers. */
#define _POSIX_C_SOURCE 200809L
#define _DARWIN_C_SOURCE

#include <fcntl.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>

#include "fmu.h"

#ifndef MSG_NOSIGNAL
#define MSG_NOSIGNAL 0 /* macOS: SO_NOSIGPIPE in its place */
#endif

extern char **environ;

static const char *python(void)
{
    const char *chosen = getenv("NASSIM_PYTHON");
    return chosen && *chosen ? chosen : FMU_PYTHON;
}

static int hex(char c)
{
    const char *digits = "0123456789abcdef", *found = c ? strchr(digits, c | 32) : NULL;
    return found ? (int)(found - digits) : -1;
}

void model_locate(model_state *s, const char *resources)
{
    const char *from = resources ? resources : "";
    size_t n = 0;
    const int uri = strncmp(from, "file:", 5) == 0;
    if (uri) { /* file:/path, file:///path or file://localhost/path */
        from += 5;
        if (strncmp(from, "//", 2) == 0 && (from = strchr(from + 2, '/')) == NULL)
            from = "";
    }
    for (; *from && n < PATH_BYTES - 1; from++) {
        const int coded = uri && *from == '%' && hex(from[1]) >= 0 && hex(from[2]) >= 0;
        s->resources[n++] = coded ? (char)(16 * hex(from[1]) + hex(from[2])) : *from;
        from += coded ? 2 : 0;
    }
    s->resources[n] = 0;
}

/* Start the process; return whether it runs. */
static int started(model_state *s)
{
    char *arguments[5], module[] = "nassim.exchange.python_run", option[] = "-m", program[PATH_BYTES];
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    pid_t process = 0;
    int pair[2], k, wrong;
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, pair) != 0)
        return 0;
    for (k = 0; k < 2; k++)
        fcntl(pair[k], F_SETFD, FD_CLOEXEC);
#ifdef SO_NOSIGPIPE
    k = 1;
    setsockopt(pair[0], SOL_SOCKET, SO_NOSIGPIPE, &k, sizeof k);
#endif
    snprintf(program, sizeof program, "%s", python());
    arguments[0] = program, arguments[1] = option, arguments[2] = module, arguments[3] = s->resources;
    arguments[4] = NULL;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, pair[1], 0);
    posix_spawn_file_actions_adddup2(&actions, pair[1], 1);
    posix_spawnattr_init(&attributes);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP); /* Ctrl-C is for the importing program */
    wrong = posix_spawnp(&process, program, &actions, &attributes, arguments, environ);
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attributes);
    close(pair[1]);
    if (wrong) {
        close(pair[0]);
        return 0;
    }
    s->process = process;
    s->channel = pair[0];
    return 1;
}

static int sent(const model_state *s, const void *bytes, size_t n)
{
    const char *from = bytes;
    while (n > 0) {
        const ssize_t done = send(s->channel, from, n, MSG_NOSIGNAL);
        if (done <= 0)
            return 0;
        from += done;
        n -= (size_t)done;
    }
    return 1;
}

static int received(const model_state *s, void *bytes, size_t n)
{
    char *to = bytes;
    while (n > 0) {
        const ssize_t done = recv(s->channel, to, n, 0);
        if (done <= 0)
            return 0;
        to += done;
        n -= (size_t)done;
    }
    return 1;
}

/* Send a request with inputs and take the reply: whether it failed, the length of its text, the text and the outputs. */
static void ask(model_state *s, char request, const double u[])
{
    int head[2], k;
    char *text;
    if (s->failure[0])
        return;
    if (!s->process && !started(s)) {
        snprintf(s->failure, TEXT_BYTES, "%.1000s cannot be run; let the environment variable NASSIM_PYTHON name a "
                 "Python that has nassim", python());
        return;
    }
    if (!sent(s, &request, 1) || (u && !sent(s, u, MODEL_INPUTS * sizeof *u)) || !received(s, head, sizeof head)) {
        snprintf(s->failure, TEXT_BYTES, "the process of %.1000s has ended; does this Python have " FMU_MADE_BY
                 "? If not, let the environment variable NASSIM_PYTHON name one that has", python());
        return;
    }
    text = head[0] ? s->failure : s->warnings;
    for (k = 0; k < head[1]; k++) {
        char c;
        if (!received(s, &c, 1))
            break;
        if (k < TEXT_BYTES - 1)
            text[k] = c, text[k + 1] = 0;
    }
    if (!head[0] && !received(s, s->y, MODEL_OUTPUTS * sizeof *s->y))
        snprintf(s->failure, TEXT_BYTES, "the process of Python has ended within a step");
}

void model_init(model_state *s, const double u[])
{
    ask(s, 'b', u);
}

void model_output(const model_state *s, const double u[], double y[])
{
    (void)u;
    memcpy(y, s->y, MODEL_OUTPUTS * sizeof *y);
}

void model_step(model_state *s, const double u[])
{
    ask(s, 's', u);
}

void model_finish(model_state *s)
{
    if (s->process)
        ask(s, 'e', NULL);
}

void model_end(model_state *s)
{
    if (s->process) {
        close(s->channel);
        waitpid((pid_t)s->process, NULL, 0);
    }
    s->process = 0;
    s->warnings[0] = s->failure[0] = 0;
}
