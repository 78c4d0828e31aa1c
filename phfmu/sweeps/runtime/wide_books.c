/* The ledger of runs side by side: the sources of that of one, with vectors as their numbers. */
#include "lane_width.h"
#define PH_WIDTH PH_LANE_WIDTH

#define ph_account ph_wide_account
#define ph_books_constant ph_wide_books_constant
#define ph_books_open ph_wide_books_open
#define ph_books_shares ph_wide_books_shares
#define ph_books_step ph_wide_books_step
#define ph_books_stored ph_wide_books_stored
#define ph_worst_share ph_wide_worst_share

#include "books.c"
