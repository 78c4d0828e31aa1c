/* Libraries of units, where they are, and what is said of them. */
#ifdef _WIN32
#include <windows.h>
#else
#include <dlfcn.h>
#endif

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "embedded.h"

#if defined(_WIN32)
#define PLATFORM PH_X86_64_WINDOWS
#elif defined(__APPLE__) && defined(__aarch64__)
#define PLATFORM PH_AARCH64_DARWIN
#elif defined(__APPLE__)
#define PLATFORM PH_X86_64_DARWIN
#elif defined(__aarch64__)
#define PLATFORM PH_AARCH64_LINUX
#else
#define PLATFORM PH_X86_64_LINUX
#endif

int ph_embedded_refuse(ph_embedded_unit *e, const char *format, ...) {
    char text[1024];
    size_t n = (size_t)snprintf(text, sizeof(text), "%s: ", e->about->member);
    va_list values;
    va_start(values, format);
    if (n < sizeof(text))
        vsnprintf(text + n, sizeof(text) - n, format, values);
    va_end(values);
    if (e->around.say)
        e->around.say(e->around.with, text);
    return PH_UNIT;
}

/* -- calls ------------------------------------------------------------------------------------------------
 */

static const char *answer_of(int status) {
    static const char *const words[] = {"ok", "warning", "discard", "error", "fatal", "pending"};
    return status >= 0 && status < 6 ? words[status] : "an unknown status";
}

/* What was answered to the call that was refused, with the unit's own words. */
static int refused(ph_embedded_unit *e) {
    const double t = e->table[e->offset[PH_TIME]];
    e->report = (ph_report){.status = PH_UNIT, .row = -1, .column = -1, .time = t};
    return ph_embedded_refuse(e, "at t = %.9g s %s was answered with %s%s%s", t,
                              e->unit.refused ? e->unit.refused : "a call", answer_of(e->unit.answer),
                              *e->words ? ": " : "", e->words);
}

int ph_embedded_asked(ph_embedded_unit *e, int status) {
    return status ? refused(e) : PH_OK;
}

void ph_embedded_hear(ph_embedded_unit *e, const char *text) {
    size_t n = 0;
    for (; text && text[n] && n + 1 < sizeof(e->words); n++)
        e->words[n] = (unsigned char)text[n] < ' ' ? ' ' : text[n];
    e->words[n] = '\0';
}

#ifdef _WIN32
static void *opened(const char *path) {
    return (void *)LoadLibraryExA(path, NULL, LOAD_WITH_ALTERED_SEARCH_PATH);
}

static const char *why(void) {
    static char text[40];
    snprintf(text, sizeof(text), "error %lu", (unsigned long)GetLastError());
    return text;
}

static void closed(void *library) {
    FreeLibrary((HMODULE)library);
}

static int found(void *library, const char *name, void *to, size_t size) {
    const FARPROC function = GetProcAddress((HMODULE)library, name);
    if (function)
        memcpy(to, &function, size);
    return function != NULL;
}
#else
static void *opened(const char *path) {
    return dlopen(path, RTLD_NOW | RTLD_LOCAL);
}

static const char *why(void) {
    const char *text = dlerror();
    return text ? text : "it does not load";
}

static void closed(void *library) {
    dlclose(library);
}

static int found(void *library, const char *name, void *to, size_t size) {
    void *function = dlsym(library, name);
    if (function)
        memcpy(to, &function, size);
    return function != NULL;
}
#endif

int ph_embedded_library(ph_embedded_unit *e) {
    const char *name = e->about->library[PLATFORM];
    char *path;
    if (!name)
        return ph_embedded_refuse(e, "the unit inside has no library for this platform");
    path = malloc(strlen(e->folder) + strlen(name) + 2);
    if (!path)
        return ph_embedded_refuse(e, "there is no memory");
    sprintf(path, "%s/%s", e->folder, name);
    e->library = opened(path);
    free(path);
    return e->library ? PH_OK : ph_embedded_refuse(e, "its library does not load: %s", why());
}

int ph_embedded_function(ph_embedded_unit *e, const char *name, void *to, size_t size) {
    if (found(e->library, name, to, size))
        return 1;
    ph_embedded_refuse(e, "its library lacks %s", name);
    return 0;
}

void ph_embedded_unload(ph_embedded_unit *e) {
    if (e->library)
        closed(e->library);
    e->library = NULL;
}

static int digit(char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
}

/* file:///C:/a%20b -> C:/a b, file:/a, file://localhost/a -> /a. */
char *ph_path_of(const char *place) {
    const int uri = strncmp(place, "file:", 5) == 0;
    char *path = malloc(strlen(place) + 1);
    size_t n = 0;
    if (!path)
        return NULL;
    if (uri) {
        place += 5;
        if (strncmp(place, "//", 2) == 0) {
            place += 2;
            while (*place && *place != '/')
                place++;
        }
        if (*place == '/' && place[1] && place[2] == ':')
            place++;
    }
    for (; *place; place++) {
        const int high = uri && *place == '%' ? digit(place[1]) : -1;
        const int low = high >= 0 ? digit(place[2]) : -1;
        path[n++] = low >= 0 ? (char)(16 * high + low) : *place;
        place += low >= 0 ? 2 : 0;
    }
    while (n > 1 && (path[n - 1] == '/' || path[n - 1] == '\\'))
        n--;
    path[n] = '\0';
    return path;
}

char *ph_uri_of(const char *path) {
    static const char plain[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~/:";
    char *uri = malloc(3 * strlen(path) + 9), *to = uri;
    if (!uri)
        return NULL;
    to += sprintf(to, *path == '/' ? "file://" : "file:///");
    for (; *path; path++)
        if (*path == '\\')
            *to++ = '/';
        else if (strchr(plain, *path))
            *to++ = *path;
        else
            to += sprintf(to, "%%%02X", (unsigned char)*path);
    *to = '\0';
    return uri;
}
